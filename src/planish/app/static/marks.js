/** The tab Marks: two views, pairs of clicks, the table of residuals, and the pictures laid over each other. */

import { labelled, choice, make, written } from "./dom.js";
import { exchange } from "./exchange.js";
import { Linked, similarityOf } from "./linked.js";
import { MapView } from "./mapview.js";
import { MarkLayer } from "./marklayer.js";
import { MarkTools } from "./marktools.js";
import { Overlay, WAYS } from "./overlay.js";
import { Prediction } from "./prediction.js";
import { MarkTable } from "./table.js";
import { titled } from "./mapside.js";
import { texture } from "./texture.js";

/**
 * @import {Point} from "./geometry.js"
 * @import {Place} from "./gestures.js"
 * @import {App} from "./main.js"
 * @import {Mark, MarkId, Side, State} from "./store.js"
 */

/** @type {Side[]} */
const SIDES = ["moving", "fixed"];

/**
 * The other side.
 * @param {Side} side one of both
 * @returns {Side}
 */
const other = (side) => (side === "moving" ? "fixed" : "moving");

const TILES =
  "Tiles are pieces of the map's texture, each placed by itself; they are not holes. To compare, show the map that shows in " +
  "the image, and take a tile that is wrong out of use.";

/**
 * What does not change of the registration that is shown.
 * @param {App} app session of this window
 * @returns {any}
 */
const factsOf = (app) => app.session.layers.find((one) => one.name === app.layer);

/**
 * Fill the tab.
 * @param {HTMLElement} panel element of the tab
 * @param {App} app session of this window
 */
export function mount(panel, app) {
  let marks;
  const open = () => {
    marks?.close();
    marks = new Marks(panel, app, open);
    marks.show(app.state);
  };
  open();
  app.onState((state) => marks?.show(state));
}

class Marks {
  /**
   * Make both views, the tools and the table.
   * @param {HTMLElement} panel element of the tab
   * @param {App} app session of this window
   * @param {() => void} anew shows the registration that was chosen
   */
  constructor(panel, app, anew) {
    this.app = app;
    this.anew = anew;
    this.names = factsOf(app).names;
    this.chosen = null;
    this.table = new MarkTable({
      choose: (id) => this.choose(id, true),
      use: (mark, used) => app.change({ do: "use", id: mark.id, used }, `${mark.label} ${used ? "used" : "not used"}`),
    }, factsOf(app));
    this.tools = new MarkTools(app, this);
    const places = { moving: make("div", { class: "view" }), fixed: make("div", { class: "view" }) };
    this.warnings = make("ul", { class: "warnings", "aria-label": "Warnings" });
    this.help = make("p", { class: "help soft" }, TILES);
    panel.classList.add("marks");
    panel.replaceChildren(
      this.tools.above,
      make("div", { class: "views" }, places.moving, places.fixed),
      make("div", { class: "under" }, this.tools.below, this.warnings, this.table.element, this.help),
    );
    this.views = { moving: this.view("moving", places.moving), fixed: this.view("fixed", places.fixed) };
    this.layers = { moving: new MarkLayer(this.views.moving, "moving"), fixed: new MarkLayer(this.views.fixed, "fixed") };
    this.linked = new Linked(this.views.moving, this.views.fixed);
    this.overlay = new Overlay(this.views.fixed, this.views.moving);
    this.prediction = new Prediction(app, this.layers, this.names);
    const way = choice(WAYS, (value) => {
      this.overlay.setWay(value);
      app.say(this.overlay.words);
    });
    this.tools.above.prepend(...this.layerBox());
    this.tools.above.append(make("div", { class: "group" }, labelled("View", way), this.overlay.control, this.followBox()));
    const goTo = (point) => (this.views.fixed.centre = point);
    const byTexture = texture(app, { newest: () => this.open, goTo });
    this.tools.below.append(exchange(app), ...(byTexture ? [byTexture] : []));
    this.boxes = { moving: this.pictureBox("moving", places.moving), fixed: this.pictureBox("fixed", places.fixed) };
    this.showLayer();
    for (const side of SIDES) this.bind(side);
  }

  /** Give the views back before others are made. */
  close() {
    this.overlay.close();
    for (const side of SIDES) this.views[side].map.setTarget(null);
  }

  /**
   * Make a view.
   * @param {Side} side plane that it shows
   * @param {HTMLElement} element element that gets it
   * @returns {MapView}
   */
  view(side, element) {
    const nudge = (dx, dy) => this.nudge(side, dx, dy);
    return new MapView({ element, name: this.names[side], app: this.app, nudge });
  }

  /**
   * The box that says which picture a view shows.
   * @param {Side} side the view
   * @param {HTMLElement} place its element
   * @returns {HTMLSelectElement}
   */
  pictureBox(side, place) {
    const box = choice([], (id) => this.showPicture(side, id));
    const shows = labelled("", box, `${this.names[side]} shows`);
    place.prepend(make("div", { class: "head" }, make("h2", {}, this.names[side]), shows, this.views[side].fields));
    return box;
  }

  /**
   * Show a picture in a view.
   * @param {Side} side the view
   * @param {string} id that of the picture
   */
  showPicture(side, id) {
    const picture = this.app.pictures.find((one) => one.id === id);
    this.views[side].show(picture);
    if (side === "moving") this.overlay.show(picture);
  }

  /** Show the pictures and holes of the registration that is chosen. */
  showLayer() {
    const { pictures } = this.app;
    const facts = factsOf(this.app);
    for (const side of SIDES) {
      const on = facts.shown[side];
      const own = (one) => Number(one.layer === on.layer);
      const shown = pictures
        .filter((one) => one.plane === on.plane && !/(^|\/)valid$/.test(one.name) && (on.plane === "fixed" || own(one)))
        .sort((a, b) => own(b) - own(a)); // the original before what was laid on it
      const options = shown.map((one) => make("option", { value: one.id }, titled({ ...one, units: "" })));
      this.boxes[side].replaceChildren(...options);
      if (shown.length) this.showPicture(side, shown[0].id);
      this.layers[side].showHoles(facts.holes[side] ?? []);
    }
  }

  /**
   * Where several layers are registered: the box that says which one.
   * @returns {HTMLElement[]} none where there is one registration only
   */
  layerBox() {
    const names = (this.app.session.layers ?? []).map((one) => one.name);
    if (names.length < 2) return [];
    const box = choice(names, async (name) => {
      await this.app.chooseLayer(name);
      this.anew();
    });
    box.value = this.app.layer;
    return [make("div", { class: "group" }, labelled("Layer", box))];
  }

  /**
   * The box that lets the views move together.
   * @returns {HTMLElement}
   */
  followBox() {
    const change = () => {
      this.linked.on = box.checked;
      this.linked.update(this.linked.map);
    };
    const box = make("input", { type: "checkbox", onchange: change });
    box.checked = true;
    return make("label", { class: "check" }, box, make("span", {}, "Move views together"));
  }

  /**
   * Let clicks, keys and drags in a view set and move marks.
   * @param {Side} side the view
   */
  bind(side) {
    const view = this.views[side];
    view.clicks.push((point, at) => this.clicked(side, point, at));
    view.hovers.push((point) => this.pointed(side, point));
    view.element.addEventListener("keydown", (event) => this.key(side, event));
    const moving = (id, point) => {
      const marks = this.app.state.marks.map((one) => (one.id === id ? { ...one, [side]: point } : one));
      this.overlay.follow(marks);
    };
    this.layers[side].dragging(moving, (id, point) => {
      this.chosen = id;
      void this.app.change({ do: "move", id, [side]: point }, "Mark moved");
    });
  }

  // --- what is shown ---------------------------------------------------------------------------------------------

  /**
   * Show another state of the session.
   * @param {State} state the new one
   */
  show(state) {
    if (this.chosen !== null && !state.marks.some((mark) => mark.id === this.chosen)) this.chosen = null;
    this.linked.update(similarityOf(state));
    this.overlay.update(state);
    this.redraw();
  }

  /** Draw marks, table, tools and warnings as they are now. */
  redraw() {
    const { state } = this.app;
    for (const side of SIDES) this.layers[side].showMarks(state.marks, this.chosen);
    this.table.show(state, this.chosen);
    this.tools.show(state, this.mark);
    this.help.hidden = !state.marks.some((one) => one.source.includes("tile"));
    const { open } = this;
    for (const side of SIDES) this.views[side].hint(open && !open[side] ? `Click ${open.label} here` : "");
    const general = (state.warnings ?? []).filter((one) => one.id === undefined || one.id === null);
    this.warnings.replaceChildren(...general.map((one) => make("li", {}, one.text)));
    this.prediction.showFor(this.mark ?? open);
  }

  /**
   * The chosen mark.
   * @returns {Mark|null}
   */
  get mark() {
    return this.app.state.marks.find((one) => one.id === this.chosen) ?? null;
  }

  /**
   * The newest mark that still has one end only.
   * @returns {Mark|null}
   */
  get open() {
    return this.app.state.marks.findLast((one) => !one.moving !== !one.fixed) ?? null;
  }

  /**
   * Choose a mark.
   * @param {MarkId|null} id null chooses none
   * @param {boolean} [go] whether the views go there
   */
  choose(id, go = false) {
    this.chosen = id;
    this.redraw();
    this.table.reveal();
    const { mark } = this;
    if (!go || !mark) return;
    for (const side of SIDES) {
      const end = mark[side] ?? mark.predicted?.[side];
      if (end && (side === "moving" || !this.linked.moves || !mark.moving)) this.views[side].centre = end;
    }
  }

  /**
   * Go on to the next mark in the order of the table.
   * @param {number} step 1, or -1 for the one before
   */
  walk(step) {
    const marks = this.table.ordered;
    if (!marks.length) return;
    const at = marks.findIndex((mark) => mark.id === this.chosen);
    const next = at < 0 ? (step > 0 ? 0 : marks.length - 1) : (at + step + marks.length) % marks.length;
    this.choose(marks[next].id, true);
    this.app.say(`${marks[next].label}, ${next + 1} of ${marks.length}`);
  }

  // --- what is done ----------------------------------------------------------------------------------------------

  /**
   * A click chooses the mark that it meets, or sets an end.
   * @param {Side} side the view
   * @param {Point} point (x, y) in um
   * @param {Place} pixel on the screen
   */
  clicked(side, point, pixel) {
    this.views[side].element.focus({ preventScroll: true });
    const meant = this.layers[side].near(pixel)?.get("id");
    const { open } = this;
    if (meant !== undefined && !(open && !open[side])) this.choose(meant);
    else void this.put(side, point);
  }

  /**
   * Set an end of a mark: of the one that waits for it, or of a new one.
   * @param {Side} side the view
   * @param {Point} point (x, y) in um
   * @returns {Promise<void>}
   */
  async put(side, point) {
    let id = null;
    const state = await this.app.change(() => {
      id = this.open?.id ?? null;
      return id === null ? { do: "add", [side]: point } : { do: "move", id, [side]: point };
    }, `Mark set in the ${this.names[side]}`);
    if (!state) return;
    if (this.open) this.app.say(`${this.app.did} Now set ${this.open.label} in the ${this.names[other(side)]}.`);
    this.choose(id ?? state.marks.at(-1).id);
    this.lead(side);
  }

  /**
   * Bring the predicted place of a mark's missing end into sight.
   * @param {Side} side where its one end was set
   */
  lead(side) {
    const there = this.mark?.predicted?.[other(side)];
    const view = this.views[other(side)];
    if (there && !this.mark?.[other(side)] && !view.sees(there)) view.centre = there;
  }

  /**
   * Move the end of the chosen mark.
   * @param {Side} side the view
   * @param {number} dx um along the plane's x
   * @param {number} dy um along the plane's y
   * @returns {boolean} whether a mark is chosen that has an end there
   */
  nudge(side, dx, dy) {
    if (!this.mark?.[side]) return false;
    const { id } = this.mark;
    void this.app.change((state) => {
      const end = state.marks.find((one) => one.id === id)?.[side];
      return end ? { do: "move", id, [side]: [end[0] + dx, end[1] + dy] } : null;
    }, "Mark moved");
    return true;
  }

  /**
   * Delete the chosen mark.
   * @returns {Promise<void>}
   */
  async remove() {
    const { mark } = this;
    if (!mark) return;
    await this.app.change({ do: "delete", id: mark.id }, `${mark.label} deleted`);
  }

  /**
   * Move both ends of the chosen mark to the middle of the hole.
   * @returns {Promise<void>}
   */
  async snap() {
    const { mark } = this;
    if (mark) await this.app.write(() => this.app.post("snap", { id: mark.id, layer: this.app.layer }), `${mark.label} snapped to its hole`);
  }

  /**
   * Say where the pointer is, and what is predicted for the other view.
   * @param {Side} side the view
   * @param {Point|null} point (x, y) in um; null where it has left the view
   */
  pointed(side, point) {
    this.app.cursor(point ? `${this.names[side]} x, y: ${written(point)} um` : "");
    this.prediction.point(side, point);
  }

  /**
   * A key of a view.
   * @param {Side} side the view
   * @param {KeyboardEvent} event the key
   */
  key(side, event) {
    if (event.ctrlKey || event.metaKey || event.altKey) return;
    const acts = {
      Enter: () => this.put(side, this.views[side].centre),
      Delete: () => this.remove(),
      Escape: () => this.choose(null),
      n: () => this.walk(1),
      p: () => this.walk(-1),
    };
    const act = acts[event.key];
    if (!act) return;
    event.preventDefault();
    void act();
  }
}

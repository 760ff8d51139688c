/** The tab Maps: two layers beside or over each other, their scatter, and what is selected in one shown in the other. */

import { Artefacts } from "./artefacts.js";
import { AtCursor, isMask } from "./atcursor.js";
import { profile } from "./charts.js";
import { colourAt } from "./colour.js";
import { button, choice, labelled, make, onNumbers, shown, typeset } from "./dom.js";
import { MapSide, titled } from "./mapside.js";
import { rawTileLayer } from "./rawtiles.js";
import { Scatter } from "./scatter.js";
import { Shapes } from "./shapes.js";

/**
 * @import {Found} from "./atcursor.js"
 * @import {Point} from "./geometry.js"
 * @import {App} from "./main.js"
 * @import {Picture} from "./rawtiles.js"
 */

/* global ol */

const NOTHING = "n 0: nothing is selected.";
/** Of maps whose r is worked out unasked. */
const MOST_PIXELS = 8_000_000;

/**
 * Pictures on the pixels of most of them: the reference where there is one.
 * @param {Picture[]} pictures those of the session
 * @returns {Picture[]}
 */
function together(pictures) {
  const grids = new Map();
  for (const one of pictures) {
    const key = JSON.stringify([one.plane, one.shape, one.origin_um, one.pixel_um]);
    grids.set(key, [...(grids.get(key) ?? []), one]);
  }
  const fixed = [...grids.values()].filter((group) => group[0].plane === "fixed" && group.length > 2);
  const from = fixed.length ? fixed : [...grids.values()];
  return from.reduce((most, group) => (group.length > most.length ? group : most), []);
}

/**
 * The picture of a variable.
 * @param {Picture[]} pictures where it is looked for
 * @param {string} name that of the variable, without its layer
 * @returns {Picture|undefined}
 */
const named = (pictures, name) =>
  pictures.find((one) => one.name.split("/").at(-1) === name);

/**
 * Fill the tab.
 * @param {HTMLElement} panel element of the tab
 * @param {App} app session of this window
 */
export function mount(panel, app) {
  new Maps(panel, app);
}

class Maps {
  /**
   * Make both maps and what belongs to them.
   * @param {HTMLElement} panel element of the tab
   * @param {App} app session of this window
   */
  constructor(panel, app) {
    this.app = app;
    this.pictures = together(app.pictures);
    if (!this.pictures.length) {
      panel.append(make("p", {}, "This run has no maps."));
      return;
    }
    this.masks = this.pictures.filter(isMask);
    const layers = this.pictures.filter((one) => !isMask(one));
    const { headline } = app.session.layers.find((one) => one.name === app.layer);
    const left = named(layers, headline) ?? layers.find((one) => !one.name.endsWith("image")) ?? layers[0];
    const others = layers.filter((one) => one !== left);
    const right = named(others, "image") ?? others[0] ?? left;
    this.region = null;
    const shared = { app, pictures: layers, onLayer: () => this.changed(), onBrush: () => this.brushed() };
    this.left = new MapSide({ ...shared, side: "Left", chosen: left });
    this.right = new MapSide({ ...shared, side: "Right", chosen: right });
    this.sides = [this.left, this.right];
    this.right.view.onLook = () => this.over?.getSource().look({ ...this.right.view.look, ...this.right.view.more });
    const drawn = (type, points) => this.drawn(type, points);
    this.shapes = new Shapes(this.sides.map((side) => side.view), { say: (text) => app.say(text), drawn });
    this.cursor = new AtCursor(app, this.sides, (found) => this.placed(found));
    this.scatter = new Scatter({
      element: make("div", { class: "map scatter", role: "application", "aria-label": "Scatter", tabindex: 0 }),
      shade: (share) => colourAt("viridis", share),
      onBrush: (a, b) => {
        [this.left.brush, this.right.brush] = [a, b];
        this.brushed();
      },
      onClear: () => this.clear(),
    });
    this.scatterWords = make("p", { class: "soft" });
    this.selection = make("p", { role: "status", "aria-label": "Selection", class: "selection" });
    this.whole = make("p", { role: "status", "aria-label": "Whole maps" });
    this.profile = make("div", { class: "profile-part", hidden: true });
    const fixed = this.pictures[0].plane === "fixed";
    const onMaps = { draw: () => this.shapes.start("Polygon"), show: (all) => this.shapes.artefacts(all) };
    this.artefacts = fixed ? new Artefacts(app, onMaps) : null;
    const scatter = make(
      "section",
      { class: "view scatter-part", "aria-label": "Scatter of both layers" },
      make("div", { class: "head" }, make("h2", {}, "Scatter"), this.scatter.bar),
      this.scatter.element,
      this.scatterWords,
      this.whole,
      this.selection,
    );
    const aside = make(
      "aside",
      { class: "panel" },
      make("section", { "aria-label": "Values at the cursor" }, make("h2", {}, "At the cursor"), this.cursor.line, this.cursor.values),
      this.artefacts?.element ?? null,
    );
    this.desk = make("div", { class: "desk" }, this.left.element, this.right.element, aside, this.cursor.section, this.profile, scatter);
    panel.classList.add("maps");
    panel.append(this.tools(), this.desk);
    this.link();
    for (const side of this.sides) this.cursor.bind(side, this.shapes);
    this.changed();
    void this.cursor.point(this.left.view.centre, this.left);
  }

  /**
   * Controls above the maps.
   * @returns {HTMLElement}
   */
  tools() {
    const way = choice(["Side by side", "Blended"], (value) => this.blend(value === "Blended"));
    this.share = make("input", { type: "range", min: 0, max: 1, step: 0.05, value: 0.5, oninput: () => this.over?.setOpacity(Number(this.share.value)) });
    this.shareBox = labelled("Share of the right layer", this.share);
    this.shareBox.hidden = true;
    this.onlyValid = make("input", { type: "checkbox", onchange: () => this.draw() });
    const places = { type: "text", size: 28, spellcheck: "false", placeholder: "x0, y0, x1, y1" };
    this.regionField = make("input", { ...places, "aria-label": "Region, um" });
    this.lineField = make("input", { ...places, "aria-label": "Line, um" });
    const read = (field, name, use) =>
      onNumbers(field, { count: 4, use, refuse: () => this.app.say(`A ${name} is "x0, y0, x1, y1" in um.`) });
    read(this.regionField, "region", (region) => this.setRegion(region));
    read(this.lineField, "line", (line) => void this.drawProfile(line));
    const valid = make("label", { class: "check" }, this.onlyValid, make("span", {}, "Only valid pixels"));
    return make(
      "div",
      { class: "tools" },
      make("div", { class: "group" }, labelled("Layout", way), this.shareBox, this.masks.length ? valid : null),
      make(
        "div",
        { class: "group" },
        button("Draw region", () => this.shapes.start("Box"), { title: "Or drag with Shift" }),
        this.regionField,
        button("Draw line", () => this.shapes.start("LineString")),
        this.lineField,
        button("Clear selection", () => this.clear()),
      ),
    );
  }

  // --- both maps as one ------------------------------------------------------------------------------------------

  /** Let both maps show the same place. */
  link() {
    const [a, b] = this.sides.map((side) => side.view.view);
    const follow = (from, to) =>
      from.on(["change:center", "change:resolution", "change:rotation"], () => {
        if (String(to.getCenter()) !== String(from.getCenter())) to.setCenter(from.getCenter());
        if (to.getResolution() !== from.getResolution()) to.setResolution(from.getResolution());
        if (to.getRotation() !== from.getRotation()) to.setRotation(from.getRotation());
      });
    follow(a, b);
    follow(b, a);
  }

  /**
   * Lay the right map over the left one, or show both side by side.
   * @param {boolean} on whether it is laid over it
   */
  blend(on) {
    this.blended = on;
    this.shareBox.hidden = !on;
    this.desk.classList.toggle("one", on);
    this.right.view.element.hidden = on;
    for (const side of this.sides) side.view.map.updateSize();
    this.draw();
  }

  /** Another layer is shown. */
  changed() {
    const same = this.left.picture === this.right.picture; // one brush is enough, and two would have one name
    this.right.brushBox.hidden = same;
    if (same) this.right.brush = null;
    this.scatter.brush = [this.left.brush, this.right.brush];
    this.draw();
    void this.count();
    void this.select();
    void this.correlate();
    if (this.line) void this.drawProfile(this.line);
    if (this.cursor.found) this.cursor.show(this.cursor.found);
  }

  /** Draw both maps as they are to look now; the server is asked for nothing but tiles that were never shown. */
  draw() {
    const brushes = this.sides.flatMap((side) => {
      const range = side.brush;
      return range ? [{ picture: side.picture, low: range[0], high: range[1] }] : [];
    });
    const layers = new Set(this.sides.map((side) => side.picture.layer));
    const more = { brushes, valid: this.masks.filter((mask) => layers.has(mask.layer)), onlyValid: this.onlyValid.checked };
    for (const side of this.sides) side.view.recolour(more);
    if (this.over) this.left.view.map.removeLayer(this.over);
    this.over = null;
    if (!this.blended) return;
    this.over = rawTileLayer(this.right.picture, this.app.api, { ...this.right.view.look, ...more });
    this.over.setOpacity(Number(this.share.value));
    this.left.view.map.getLayers().insertAt(1, this.over);
  }

  // --- what is selected ------------------------------------------------------------------------------------------

  /** Other values are picked. */
  brushed() {
    this.scatter.brush = [this.left.brush, this.right.brush];
    this.scatter.draw();
    this.draw();
    void this.select();
  }

  /**
   * Pick the pixels of a region.
   * @param {number[]|null} region two corners, x, y, x, y in um; null picks all
   */
  setRegion(region) {
    const sorted = (k) => [region?.[k] ?? 0, region?.[k + 2] ?? 0].sort((a, b) => a - b);
    const [xs, ys] = [sorted(0), sorted(1)];
    this.region = region && [xs[0], ys[0], xs[1], ys[1]];
    this.regionField.value = this.region ? this.region.map((um) => String(Number(um.toFixed(1)))).join(", ") : "";
    this.shapes.region(this.region);
    void this.countRegion();
    void this.select();
  }

  /** Pick nothing: neither a region nor values. */
  clear() {
    for (const side of this.sides) side.brush = null;
    this.setRegion(null);
    this.brushed();
  }

  /**
   * Both layers and the region, as the server is asked for them.
   * @returns {string}
   */
  get query() {
    return `a=${this.left.picture.id}&b=${this.right.picture.id}${this.region ? `&region=${this.region.join()}` : ""}`;
  }

  /**
   * The points of the layers that are shown, of which those of a region are chosen.
   * @returns {Promise<void>}
   */
  async count() {
    const [a, b] = [this.left.picture, this.right.picture];
    this.density = await this.latest("density", `density?a=${a.id}&b=${b.id}`);
    if (!this.density) return;
    const { n, beyond, pixel_um: pixel } = this.density;
    this.scatterWords.textContent = `Scatter of ${n} points${beyond ? `, ${beyond} of them beyond its limits` : ""}; pixels of ${shown(pixel[1])} µm.`;
    await this.countRegion();
  }

  /**
   * Show the scatter, with the points of the region chosen.
   * @returns {Promise<void>}
   */
  async countRegion() {
    const region = this.region && (await this.latest("points", `density?${this.query}`));
    if (!this.density || (this.region && !region)) return;
    const { bins, a_low, a_high, b_low, b_high } = this.density;
    const axes = [
      { label: titled(this.left.picture), low: a_low, high: a_high },
      { label: titled(this.right.picture), low: b_low, high: b_high },
    ];
    this.scatter.show({ axes, wide: bins, tall: bins, counts: countsOf(this.density), chosen: region ? countsOf(region) : null });
  }

  /**
   * The cursor stands at a place: it is seen in both maps and in the scatter.
   * @param {Found} found what lies at the cursor
   */
  placed(found) {
    this.shapes.cursor([found.x, found.y]);
    const value = ({ id }) => found.values.find((one) => one.id === id)?.value ?? NaN;
    this.scatter.here = [value(this.left.picture), value(this.right.picture)];
    this.scatter.draw();
  }

  /**
   * Say what is selected, of all pixels; of the whole maps where nothing is.
   * @returns {Promise<void>}
   */
  async select() {
    const [a, b] = [this.left.brush, this.right.brush];
    this.running.selection?.abort();
    if (!this.region && !a && !b) {
      this.selection.textContent = NOTHING;
      return;
    }
    this.selection.textContent = "n: counting all pixels …";
    const brushes = `${a ? `&brush_a=${a.join()}` : ""}${b ? `&brush_b=${b.join()}` : ""}`;
    const found = await this.latest("selection", `selection?${this.query}${brushes}`);
    if (!found) return;
    const said = a || b ? `${saidOf(found)}: selecting by value biases it` : saidOf(found);
    const what = this.sides.map((side) => titled({ ...side.picture, units: "" })).join(" and ");
    const words = [`${said} (${what}, pixels of ${shown(found.pixel_um[1])} um).`, ...found.warnings];
    this.selection.textContent = typeset(words.join(" "));
  }

  /**
   * Say how the whole maps are correlated, where that does not take long.
   * @returns {Promise<void>}
   */
  async correlate() {
    this.whole.textContent = "";
    const [a, b] = [this.left.picture, this.right.picture];
    if (a === b || a.shape[0] * a.shape[1] > MOST_PIXELS) return;
    const found = await this.latest("whole", `selection?a=${a.id}&b=${b.id}`);
    if (found) this.whole.textContent = `Whole maps: ${saidOf(found)}.`;
  }

  running = {};

  /**
   * What the server answers to the newest of some questions; null to those that are not wanted any more.
   * @param {string} kind the questions among which the newest counts
   * @param {string} path below `/api/`
   * @returns {Promise<any>}
   */
  async latest(kind, path) {
    this.running[kind]?.abort();
    const mine = (this.running[kind] = new AbortController());
    try {
      const found = await this.app.api.get(path, { signal: mine.signal });
      return this.running[kind] === mine ? found : null;
    } catch (error) {
      if (mine.signal.aborted) return null;
      if (kind === "selection") this.selection.textContent = NOTHING;
      this.app.say(error.message);
      return null;
    }
  }

  // --- what is drawn ---------------------------------------------------------------------------------------------

  /**
   * A person has drawn something over a map.
   * @param {string} type a key of `HOW` in shapes.js
   * @param {Point[]} points corners or ends, (x, y) in um
   * @returns {void}
   */
  drawn(type, points) {
    if (type === "Polygon") return this.artefacts?.drawn(points);
    if (type === "Box") {
      const [xs, ys] = [0, 1].map((k) => points.map((point) => point[k]));
      return this.setRegion([Math.min(...xs), Math.min(...ys), Math.max(...xs), Math.max(...ys)]);
    }
    const ends = points.flat();
    this.lineField.value = ends.map((um) => um.toFixed(1)).join(", ");
    void this.drawProfile(ends);
  }

  /**
   * Show the values along a line.
   * @param {number[]|null} line both ends, x, y, x, y in um; null shows none
   * @returns {Promise<void>}
   */
  async drawProfile(line) {
    this.line = line;
    this.shapes.line(line);
    const found = line && (await this.latest("profile", `profile?a=${this.left.picture.id}&b=${this.right.picture.id}&line=${line.join()}`));
    this.profile.hidden = !found;
    if (!found) return;
    const close = () => {
      this.lineField.value = "";
      void this.drawProfile(null);
    };
    this.profile.replaceChildren(profile(found, this.sides.map((side) => titled(side.picture)), close));
  }
}

/**
 * n, r and its interval in words.
 * @param {object} selection answer of the server
 * @param {number} selection.n pixels
 * @param {number|null} selection.r null where there is none
 * @param {number[]|null} selection.interval of r, 95 %
 * @param {number|null} selection.n_eff independent pixels
 * @returns {string}
 */
function saidOf({ n, r, interval, n_eff: independent }) {
  const parts = [`n ${n}`, r === null ? "no r" : `r ${r.toFixed(4)}`];
  if (interval) parts.push(`95 % interval ${interval.map((v) => v.toFixed(4)).join(" to ")}`);
  if (independent !== null) parts.push(`n_eff ${independent.toFixed(1)}`);
  return parts.join("; ");
}

/**
 * Counts of a density, row by row from the lowest b up.
 * @param {object} density answer of the server
 * @param {string} density.counts 32 bits each, in base64
 * @returns {Uint32Array}
 */
const countsOf = ({ counts }) => new Uint32Array(Uint8Array.from(atob(counts), (one) => one.charCodeAt(0)).buffer);

/** The tab Maps: two layers beside or over each other, their scatter, and what is selected in one shown in the other. */

import { Artefacts } from "./artefacts.js";
import { AtCursor, isMask } from "./atcursor.js";
import { profile, shown } from "./charts.js";
import { button, choice, labelled, make, numbers } from "./dom.js";
import { MapSide } from "./mapside.js";
import { rawTileLayer } from "./rawtiles.js";
import { Scatter } from "./scatter.js";
import { Shapes } from "./shapes.js";

/* global ol */

const HELP =
  "Drag in the scatter to choose values; their pixels are painted in both maps. Choose a region to see its points and r. " +
  "Keys in a map: arrows move it, + and - zoom, 0 shows all, Enter takes the place in the middle. Esc in the scatter clears.";
const NOTHING = "n 0: nothing is selected.";
/** Pictures on the pixels of most of them: the reference where there is one. @param {any[]} pictures */
function together(pictures) {
  /** @type {Map<string, any[]>} */
  const grids = new Map();
  for (const one of pictures) {
    const key = JSON.stringify([one.plane, one.shape, one.origin_um, one.pixel_um]);
    grids.set(key, [...(grids.get(key) ?? []), one]);
  }
  const fixed = [...grids.values()].filter((group) => group[0].plane === "fixed" && group.length > 2);
  const from = fixed.length ? fixed : [...grids.values()];
  return from.reduce((most, group) => (group.length > most.length ? group : most), []);
}

const named = (/** @type {any[]} */ pictures, /** @type {string} */ name) =>
  pictures.find((one) => one.name.split("/").at(-1) === name);

/** @param {HTMLElement} panel @param {any} app */
export function mount(panel, app) {
  new Maps(panel, app);
}

class Maps {
  /** @param {HTMLElement} panel @param {any} app */
  constructor(panel, app) {
    this.app = app;
    this.pictures = together(app.pictures);
    if (!this.pictures.length) {
      panel.append(make("p", {}, "This run has no maps."));
      return;
    }
    this.masks = this.pictures.filter(isMask);
    const layers = this.pictures.filter((one) => !isMask(one));
    const { headline } = app.session.layers.find((/** @type {any} */ one) => one.name === app.layer);
    const left = named(layers, headline) ?? layers.find((one) => !one.name.endsWith("image")) ?? layers[0];
    const others = layers.filter((one) => one !== left);
    const right = named(others, "image") ?? others[0] ?? left;
    /** @type {number[]|null} */
    this.region = null;
    const shared = { app, pictures: layers, onLayer: () => this.changed(), onLook: () => this.draw(), onBrush: () => this.brushed() };
    this.left = new MapSide({ ...shared, side: "Left", chosen: left });
    this.right = new MapSide({ ...shared, side: "Right", chosen: right });
    this.sides = [this.left, this.right];
    const drawn = (/** @type {string} */ type, /** @type {number[][]} */ points) => this.drawn(type, points);
    this.shapes = new Shapes(this.sides.map((side) => side.view), { say: (text) => app.say(text), drawn });
    this.cursor = new AtCursor(app, this.sides);
    this.scatter = new Scatter({
      onBrush: (a, b) => {
        [this.left.brush, this.right.brush] = [a, b];
        this.brushed();
      },
      onClear: () => this.clear(),
      say: (text) => app.say(text),
    });
    this.scatterWords = make("p", { class: "soft" });
    this.profile = make("div");
    panel.classList.add("maps");
    const scatter = make(
      "section",
      { class: "view", "aria-label": "Scatter of both layers" },
      make("div", { class: "head" }, make("h2", {}, "Scatter"), this.scatter.fields),
      this.scatter.element,
      this.scatterWords,
    );
    this.views = make("div", { class: "views" }, this.left.element, this.right.element, scatter);
    const fixed = this.pictures[0].plane === "fixed";
    const onMaps = { draw: () => this.shapes.sketch("Polygon"), show: (/** @type {any} */ all) => this.shapes.artefacts(all) };
    this.artefacts = fixed ? new Artefacts(app, onMaps) : null;
    panel.append(
      this.tools(),
      this.views,
      make(
        "div",
        { class: "beside" },
        make("section", { class: "panel", "aria-label": "Values at the cursor" }, make("h2", {}, "At the cursor"), this.cursor.values),
        make("div", { class: "panel" }, this.profile, this.artefacts?.element ?? null),
      ),
      make("p", { class: "help soft" }, HELP),
    );
    this.link();
    for (const side of this.sides) this.cursor.bind(side, () => this.shapes.sketching !== null, () => this.shapes.end());
    this.changed();
  }

  /** Controls above the maps. */
  tools() {
    const way = choice(["Side by side", "Blended"], (value) => this.blend(value === "Blended"));
    this.share = make("input", { type: "range", min: 0, max: 1, step: 0.05, value: 0.5, oninput: () => this.draw() });
    this.shareBox = labelled("Share of the right layer", this.share);
    this.shareBox.hidden = true;
    this.onlyValid = make("input", { type: "checkbox", onchange: () => this.draw() });
    this.regionField = make("input", { type: "text", size: 26, spellcheck: "false" });
    this.lineField = make("input", { type: "text", size: 26, spellcheck: "false" });
    this.field(this.regionField, "A region is \"x0, y0, x1, y1\" in um.", (region) => this.setRegion(region));
    this.field(this.lineField, "A line is \"x0, y0, x1, y1\" in um.", (line) => void this.drawProfile(line));
    return make(
      "div",
      { class: "tools" },
      make(
        "div",
        { class: "group" },
        labelled("Layout", way),
        this.shareBox,
        this.masks.length ? make("label", { class: "check" }, this.onlyValid, make("span", {}, "Only valid pixels")) : null,
        this.cursor.slice,
      ),
      make(
        "div",
        { class: "group" },
        button("Draw region", () => this.shapes.sketch("Box")),
        labelled("Region, um", this.regionField),
        button("Draw line", () => this.shapes.sketch("LineString")),
        labelled("Line, um", this.lineField),
        button("Clear selection", () => this.clear()),
      ),
    );
  }

  /** @param {HTMLInputElement} field @param {string} needed @param {(values: number[]|null) => void} use */
  field(field, needed, use) {
    field.addEventListener("change", () => {
      const values = numbers(field.value, 4);
      const valid = values !== null || field.value.trim() === "";
      field.setAttribute("aria-invalid", String(!valid));
      if (valid) use(values);
      else this.app.say(needed);
    });
  }

  // --- both maps as one ------------------------------------------------------------------------------------------

  /** Let both maps show the same place. */
  link() {
    const [a, b] = this.sides.map((side) => side.view.view);
    const follow = (/** @type {any} */ from, /** @type {any} */ to) =>
      from.on(["change:center", "change:resolution", "change:rotation"], () => {
        if (String(to.getCenter()) !== String(from.getCenter())) to.setCenter(from.getCenter());
        if (to.getResolution() !== from.getResolution()) to.setResolution(from.getResolution());
        if (to.getRotation() !== from.getRotation()) to.setRotation(from.getRotation());
      });
    follow(a, b);
    follow(b, a);
  }

  /** @param {boolean} on */
  blend(on) {
    this.blended = on;
    this.shareBox.hidden = !on;
    this.views.classList.toggle("one", on);
    this.right.view.element.hidden = on;
    for (const side of this.sides) side.view.map.updateSize();
    this.draw();
  }

  /** Another layer is shown. */
  changed() {
    const same = this.left.picture === this.right.picture; // one brush is enough, and two would have one name
    this.right.brushBox.hidden = same;
    if (same) this.right.brush = null;
    this.draw();
    this.scatter.showBrush([this.left.brush, this.right.brush]);
    void this.count();
    void this.select();
  }

  /** Draw both maps as they are to look now; the server is asked for nothing but tiles that were never shown. */
  draw() {
    const brushes = this.sides.flatMap((side) => {
      const range = side.brush;
      return range ? [{ picture: side.picture, low: range[0], high: range[1] }] : [];
    });
    const layers = new Set(this.sides.map((side) => side.picture.layer));
    const more = { brushes, valid: this.masks.filter((mask) => layers.has(mask.layer)), onlyValid: this.onlyValid.checked };
    for (const side of this.sides) side.draw(more);
    if (this.over) this.left.view.map.removeLayer(this.over);
    this.over = null;
    if (!this.blended) return;
    this.over = rawTileLayer(this.right.picture, this.app.api, { ...this.right.look, ...more });
    this.over.setOpacity(Number(this.share.value));
    this.left.view.map.getLayers().insertAt(1, this.over);
  }

  // --- what is selected ------------------------------------------------------------------------------------------

  brushed() {
    this.draw();
    this.scatter.showBrush([this.left.brush, this.right.brush]);
    void this.select();
  }

  /** @param {number[]|null} region */
  setRegion(region) {
    const sorted = (/** @type {number} */ k) => [region?.[k] ?? 0, region?.[k + 2] ?? 0].sort((a, b) => a - b);
    const [xs, ys] = [sorted(0), sorted(1)];
    this.region = region && [xs[0], ys[0], xs[1], ys[1]];
    this.regionField.value = this.region ? this.region.map((um) => String(Number(um.toFixed(3)))).join(", ") : "";
    this.shapes.region(this.region);
    void this.countRegion();
    void this.select();
  }

  clear() {
    for (const side of this.sides) side.brush = null;
    this.app.selection(NOTHING);
    this.setRegion(null);
    this.brushed();
  }

  get query() {
    return `a=${this.left.picture.id}&b=${this.right.picture.id}${this.region ? `&region=${this.region.join()}` : ""}`;
  }

  /** Density and histograms of the layers that are shown. */
  async count() {
    const [a, b] = [this.left.picture, this.right.picture];
    const found = await this.latest("density", `density?a=${a.id}&b=${b.id}`);
    if (found) {
      const title = (/** @type {any} */ one) => `${one.name}${one.units && one.units !== "1" ? `, ${one.units}` : ""}`;
      this.scatter.show(found, [title(a), title(b)]);
      const beyond = found.beyond ? `, ${found.beyond} of them beyond its limits` : "";
      this.scatterWords.textContent = `Scatter of ${found.n} points${beyond}; pixels of ${shown(found.pixel_um[1])} um.`;
      await this.countRegion();
    }
    for (const side of this.sides) {
      const counted = await this.latest(`histogram ${side.view.name}`, `histogram?id=${side.picture.id}`);
      if (counted) side.showHistogram(counted);
    }
  }

  async countRegion() {
    if (!this.region) return this.scatter.showRegion(null);
    const found = await this.latest("points", `density?${this.query}`);
    if (found && this.region) this.scatter.showRegion(found);
  }

  /** Say what is selected, of all pixels; after it was drawn. */
  async select() {
    const [a, b] = [this.left.brush, this.right.brush];
    this.running.selection?.abort();
    if (!this.region && !a && !b) return this.app.selection(NOTHING);
    this.app.selection("n: counting all pixels …");
    const brushes = `${a ? `&brush_a=${a.join()}` : ""}${b ? `&brush_b=${b.join()}` : ""}`;
    const found = await this.latest("selection", `selection?${this.query}${brushes}`);
    if (!found) return;
    const what = `${this.left.picture.name} and ${this.right.picture.name}`;
    const parts = [`n ${found.n}`];
    if (found.r !== null) parts.push(`r ${found.r.toFixed(4)}`);
    if (found.interval) parts.push(`95 % interval ${found.interval.map((/** @type {number} */ v) => v.toFixed(4)).join(" to ")}`);
    if (found.n_eff !== null) parts.push(`n_eff ${found.n_eff.toFixed(1)}`);
    if (a || b) parts.push("no r: values were picked, which biases it");
    const words = [`${parts.join("; ")} (${what}, pixels of ${shown(found.pixel_um[1])} um).`, ...found.warnings];
    this.app.selection(words.join(" "));
  }

  /** @type {Record<string, AbortController>} */
  running = {};

  /**
   * What the server answers to the newest of some questions; null to those that are not wanted any more.
   * @param {string} kind
   * @param {string} path
   */
  async latest(kind, path) {
    this.running[kind]?.abort();
    const mine = (this.running[kind] = new AbortController());
    try {
      const found = await this.app.api.get(path, { signal: mine.signal });
      return this.running[kind] === mine ? found : null;
    } catch (/** @type {any} */ error) {
      if (mine.signal.aborted) return null;
      if (kind === "selection") this.app.selection(NOTHING);
      this.app.say(error.message);
      return null;
    }
  }

  // --- what is drawn ---------------------------------------------------------------------------------------------

  /** @param {string} type @param {number[][]} points */
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

  /** @param {number[]|null} line */
  async drawProfile(line) {
    this.shapes.line(line);
    this.profile.replaceChildren();
    if (!line) return;
    const found = await this.latest("profile", `profile?a=${this.left.picture.id}&b=${this.right.picture.id}&line=${line.join()}`);
    if (found) this.profile.replaceChildren(profile(found));
  }
}

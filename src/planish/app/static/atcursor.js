/** What lies under the cursor of either map: values of all layers, the place in the volume, and its slice. */

import { button, make, shown, withUnit } from "./dom.js";
import { titled } from "./mapside.js";
import { Slice } from "./slicedata.js";
import { SliceView } from "./sliceview.js";

/**
 * @import {Point} from "./geometry.js"
 * @import {App} from "./main.js"
 * @import {MapSide} from "./mapside.js"
 * @import {Shapes} from "./shapes.js"
 * @import {SlicePlace, VolumePlace} from "./slicedata.js"
 * @typedef {{id: string, name: string, title: string, units: string, value: any}} Value of a layer: a number, of a mask a truth value, null where there is none
 * @typedef {{x: number, y: number, values: Value[], volume: VolumePlace|null}} Found what lies at a point, in um
 */

/**
 * Tell whether a picture says which pixels are valid.
 * @param {{name: string}} one a picture
 * @returns {boolean}
 */
export const isMask = (one) => one.name.split("/").at(-1) === "valid";

export class AtCursor {
  /**
   * Make the lines, the table and the slice.
   * @param {App} app session of this window
   * @param {MapSide[]} sides both maps; the layers that they show come first
   * @param {(found: Found) => void} onPlace called with what lies at the cursor
   */
  constructor(app, sides, onPlace) {
    this.app = app;
    this.sides = sides;
    this.onPlace = onPlace;
    const status = (name) => make("p", { role: "status", "aria-label": name, "aria-live": "off" });
    this.line = status("Cursor");
    this.slicePlace = status("Slice position");
    this.values = make("div", { class: "values", tabindex: 0, role: "group", "aria-label": "Table of values" });
    this.slice = button("Show slice", () => this.showSlice(), { disabled: true, title: "Go to this slice in Surfaces" });
    this.view = new SliceView({ onCursor: () => {}, onPoint: (at) => void this.fromSlice(at), onStep: () => {}, onBack: () => {} });
    this.section = make(
      "section",
      { class: "view slice-part", "aria-label": "Slice at the cursor", hidden: true },
      make("div", { class: "head" }, make("h2", {}, "Slice"), this.slice, this.slicePlace),
      this.view.frame,
    );
    this.sheets = [];
    void this.openSheets();
    this.wanted = null;
    this.asking = false;
    this.taken = null;
  }

  /**
   * Ask which layers have slices.
   * @returns {Promise<void>}
   */
  async openSheets() {
    const { sheets } = await this.app.api.get("sheets").catch(() => ({ sheets: [] }));
    this.sheets = sheets.filter((one) => !one.error);
    this.section.hidden = !this.sheets.length;
    if (this.found) this.show(this.found);
  }

  /**
   * Follow the pointer over a map; with a tool of `shapes`, a click means a corner.
   * @param {MapSide} side the map
   * @param {Shapes} shapes what is drawn over it
   */
  bind(side, shapes) {
    const { view } = side;
    const click = (point) => (shapes.tool ? shapes.corner(point, view) : void this.take(point, side));
    view.hovers.push((point) => point && void this.point(point, side));
    view.clicks.push(click);
    view.element.addEventListener("keydown", (event) => {
      if (event.target !== view.element) return;
      if (event.key === "Enter") click(view.centre);
      else if (event.key === "Escape") shapes.end();
      else void this.point(view.centre, side);
    });
  }

  /**
   * Ask what lies at a point.
   * @param {Point} point (x, y) in um
   * @param {MapSide} side map in which it lies
   * @returns {Promise<Found|null>} null where the server gives no answer
   */
  ask([x, y], side) {
    return this.app.api.get(`cursor?id=${side.picture.id}&x=${x}&y=${y}`).catch(() => null);
  }

  /**
   * Say what lies at a point; one question is asked at a time.
   * @param {Point} point (x, y) in um
   * @param {MapSide} side map in which it lies
   * @returns {Promise<void>}
   */
  async point(point, side) {
    this.wanted = point;
    if (this.asking) return;
    this.asking = true;
    while (this.wanted) {
      const at = this.wanted;
      this.wanted = null;
      const found = await this.ask(at, side);
      if (found) this.show(found);
    }
    this.asking = false;
  }

  /**
   * Show what lies at the cursor.
   * @param {Found} found answer of the server
   */
  show(found) {
    this.found = found;
    const { x, y, volume } = found;
    const first = this.sides.map((side) => side.picture.id);
    const rank = ({ id }) => (first.includes(id) ? first.indexOf(id) : 2);
    const values = [...found.values].sort((a, b) => rank(a) - rank(b));
    // Seen is the place; names and values stand in the table, and here for those who read the line alone.
    const said = values.map((one) => `${one.name} ${written(one)}`).join("; ");
    this.line.replaceChildren(`x ${x.toFixed(2)}, y ${y.toFixed(2)} µm${volume || this.sheets.length ? `; ${inVolume(volume)}` : ""}`, make("span", { class: "sr" }, `; ${said}`));
    const rows = values.map((one) =>
      make("tr", { class: first.includes(one.id) ? "shown" : null }, make("th", { scope: "row" }, titled({ ...one, units: "" })), make("td", { class: "n" }, written(one))),
    );
    this.values.replaceChildren(make("table", { "aria-label": "Values at the cursor" }, make("tbody", {}, ...rows)));
    this.onPlace(found);
    void this.cut(volume);
  }

  /**
   * Show the slice through a place of the volume; one is asked for at a time.
   * @param {VolumePlace|null} volume null where the point lies in no volume
   * @returns {Promise<void>}
   */
  async cut(volume) {
    const sheet = this.sheets.find((one) => one.layer === volume?.layer) ?? this.sheets[0]; // one linked to an image has its layer
    if (!volume || !sheet || !this.section.offsetParent) return;
    this.place = { sheet, volume };
    if (this.cutting) return;
    this.cutting = true;
    while (this.place) {
      const { sheet: { layer, rows, cols, through, axes, thickness_um: thick }, volume: at } = this.place;
      this.place = null;
      const axis = axes[rows];
      const index = Math.max(0, Math.min(axis.count - 1, Math.round((at[rows] - axis.first_um) / axis.step_um)));
      const path = `slices/${encodeURIComponent(layer)}/${rows}/${index}?across=${at[cols]}&down=${at[through]}`;
      const known = this.view.slice?.facts;
      if (known?.layer !== layer || known?.index !== index || known?.direction !== rows) {
        const answer = await this.app.api.fetch(path).catch(() => null);
        if (!answer) break;
        const slice = new Slice(await answer.arrayBuffer());
        const { offset, scale } = slice.facts;
        this.view.range = slice.histogram().range.map((value) => (value - offset) / scale);
        this.view.show(slice);
      }
      this.view.marked = { across: at[cols], down: at[through] };
      this.view.lookAt(at[cols], at[through], this.zoomed ? undefined : this.view.canvas.clientHeight / (4 * thick));
      this.zoomed = true;
    }
    this.cutting = false;
  }

  /**
   * Take a place whose slice is shown.
   * @param {Point} point (x, y) in um
   * @param {MapSide} side map in which it lies
   * @returns {Promise<void>}
   */
  async take(point, side) {
    this.wanted = null;
    const found = await this.ask(point, side);
    if (!found) return;
    this.show(found);
    this.taken = found.volume;
    this.slice.disabled = !this.taken || !this.sheets.length;
    this.slicePlace.textContent = this.taken ? inVolume(this.taken).replace("volume ", "") : "";
  }

  /**
   * A click in the slice: the cursor of the maps goes there.
   * @param {SlicePlace} at place in the slice
   * @returns {Promise<void>}
   */
  async fromSlice(at) {
    const { facts } = this.view.slice;
    const side = this.sides[0];
    const query = new URLSearchParams({ id: side.picture.id, layer: facts.layer, [facts.normal]: String(facts.at_um), [facts.across.name]: String(at.across) });
    const found = await this.app.api.get(`pixel?${query}`).catch(() => null);
    if (found) await this.take([found.x, found.y], side);
  }

  /**
   * Go to the slice in the tab Surfaces.
   * @returns {Promise<void>}
   */
  async showSlice() {
    if (!this.taken) return;
    await this.app.openTab("surfaces");
    this.app.showSlice?.(this.taken.x, this.taken.y, this.taken.z, this.taken.layer);
  }
}

/**
 * A place of the volume in words.
 * @param {VolumePlace|null} volume null where there is none
 * @returns {string}
 */
const inVolume = (volume) =>
  volume ? `volume x ${volume.x.toFixed(2)}, y ${volume.y.toFixed(2)}, z ${volume.z.toFixed(2)} µm` : "not in the volume";

/**
 * A value with its unit.
 * @param {Value} one value of a layer
 * @returns {string}
 */
function written(one) {
  if (one.value === null) return "no value";
  if (isMask(one)) return one.value ? "yes" : "no";
  return shown(one.value) + withUnit(one);
}

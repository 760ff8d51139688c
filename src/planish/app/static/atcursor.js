/** What lies under the cursor of either map: values of all layers, and the place in the volume, whose slice can be shown. */

import { shown } from "./charts.js";
import { button, make } from "./dom.js";
import { flipped } from "./mapview.js";

/** @typedef {import("./mapside.js").MapSide} MapSide */

export const isMask = (/** @type {any} */ one) => one.name.split("/").at(-1) === "valid";

export class AtCursor {
  /** @param {any} app @param {MapSide[]} sides the layers that are shown come first */
  constructor(app, sides) {
    this.app = app;
    this.sides = sides;
    this.values = make("div", { class: "values" });
    this.slice = button("Show slice", () => this.showSlice(), { disabled: true });
    /** @type {number[]|null} */
    this.wanted = null;
    this.asking = false;
    /** @type {any} */
    this.taken = null;
  }

  /** @param {MapSide} side @param {() => boolean} busy whether clicks mean something else @param {() => void} leave */
  bind(side, busy, leave) {
    const { map, element } = side.view;
    map.on("pointermove", (/** @type {any} */ event) => !event.dragging && void this.point(flipped(event.coordinate), side));
    map.on("click", (/** @type {any} */ event) => !busy() && void this.take(flipped(event.coordinate), side));
    element.addEventListener("keydown", (/** @type {KeyboardEvent} */ event) => {
      if (event.key === "Enter") void this.take(side.view.centre, side);
      else if (event.key === "Escape") leave();
      else void this.point(side.view.centre, side);
    });
  }

  /** @param {number[]} point @param {MapSide} side */
  ask([x, y], side) {
    return this.app.api.get(`cursor?id=${side.picture.id}&x=${x}&y=${y}`).catch(() => null);
  }

  /** Say what lies at a point; one question is asked at a time. @param {number[]} point @param {MapSide} side */
  async point(point, side) {
    this.wanted = point;
    if (this.asking) return;
    this.asking = true;
    let found = null;
    while (this.wanted) {
      const at = this.wanted;
      this.wanted = null;
      found = await this.ask(at, side);
    }
    this.asking = false;
    if (found) this.show(found);
  }

  /** @param {any} found */
  show(found) {
    const { x, y, volume } = found;
    const place = volume ? `volume x ${volume.x.toFixed(2)}, y ${volume.y.toFixed(2)}, z ${volume.z.toFixed(2)} um` : "not in the volume";
    const first = this.sides.map((side) => side.picture.id);
    const order = (/** @type {any} */ one) => (first.includes(one.id) ? 0 : 1);
    const values = [...found.values].sort((a, b) => order(a) - order(b));
    const said = values.map((one) => `${one.name} ${written(one)}`).join("; ");
    this.app.cursor(`x ${x.toFixed(2)}, y ${y.toFixed(2)} um; ${place}; ${said}`);
    const rows = values.map((one) =>
      make("tr", {}, make("th", { scope: "row" }, one.name), make("td", { class: "n" }, written(one)), make("td", {}, one.title)),
    );
    const table = make("table", { "aria-label": "Values at the cursor" }, make("tbody", {}, ...rows));
    this.values.replaceChildren(make("p", {}, `x ${x.toFixed(1)}, y ${y.toFixed(1)} um; ${place}`), table);
  }

  /** Take a place whose slice is shown. @param {number[]} point @param {MapSide} side */
  async take(point, side) {
    this.wanted = null;
    const found = await this.ask(point, side);
    if (!found) return;
    this.show(found);
    this.taken = found.volume;
    this.slice.disabled = !this.taken;
    const { x, y, z } = found.volume ?? {};
    this.app.slicePosition?.(found.volume ? `x ${x.toFixed(2)}, y ${y.toFixed(2)}, z ${z.toFixed(2)} um` : "");
  }

  async showSlice() {
    if (!this.taken) return;
    await this.app.openTab("surfaces");
    this.app.showSlice?.(this.taken.x, this.taken.y, this.taken.z, this.taken.layer);
  }
}

/** @param {any} one a value with its unit */
function written(one) {
  if (one.value === null) return "no value";
  if (isMask(one)) return one.value ? "yes" : "no";
  return `${shown(one.value)}${one.units && one.units !== "1" ? ` ${one.units}` : ""}`;
}

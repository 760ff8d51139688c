/** Colour bar, histogram and limits of the colours of a view: dragged, moved by keys, or written as numbers. */

import { button, make, onNumbers, shown, withUnit } from "./dom.js";

/**
 * @import {Shade} from "./colour.js"
 * @typedef {{n: number, low: number, high: number, counts: number[], range: number[], beyond?: number,
 *   mean?: number, sd?: number, median?: number, pixel_um?: number[]}} Histogram
 *   `range` holds nearly all values; `beyond` of them lie outside of `low` to `high`
 * @typedef {{name: string, title: string, units: string, range: number[], shade: Shade, counted: Histogram|null}} Coloured
 *   values that are shown in colours
 */

const [WIDE, BARS, TALL] = [256, 20, 30];

export class Contrast {
  /**
   * Make the bar, the handles and the field.
   * @param {object} parts what it is for
   * @param {string} parts.name name of the field
   * @param {() => void} parts.onChange called when the limits are others
   * @param {(text: string) => void} parts.say tells what is wrong with a number
   * @param {HTMLElement|null} [parts.before] stands in front of the field
   */
  constructor({ name, onChange, say, before = null }) {
    this.onChange = onChange;
    this.canvas = make("canvas", { role: "img", width: WIDE, height: TALL });
    this.handles = ["low", "high"].map((end, k) => this.handle(`${name}, ${end}`, k));
    this.track = make("div", { class: "track", ondblclick: () => this.reset() }, this.canvas, ...this.handles);
    this.field = make("input", { type: "text", size: 13, spellcheck: "false", "aria-label": name, title: "Limits of the colours: low, high" });
    onNumbers(this.field, {
      count: 2, valid: ([low, high]) => low < high, use: (found) => this.set(found ?? this.usual),
      refuse: () => say(`A ${name.split(" ").slice(-2).join(" ")} is "low, high", the smaller number first.`),
    });
    const auto = button("Auto", () => this.reset(), { "aria-label": `${name}: auto`, title: "Limits as at the start" });
    this.element = make("div", { class: "contrast" }, before, this.field, this.track, auto);
    this.limits = this.usual = this.span = [0, 1];
  }

  /**
   * Show the colours of other values.
   * @param {Coloured} values whose colours, with their histogram where it is known
   */
  show(values) {
    const untouched = this.values?.name !== values.name || String(this.limits) === String(this.usual);
    this.values = values;
    const { counted } = values;
    this.usual = counted?.range[0] < counted?.range[1] ? counted.range : values.range;
    const margin = 0.25 * (this.usual[1] - this.usual[0] || 1);
    this.span = counted ? [counted.low, counted.high] : [this.usual[0] - margin, this.usual[1] + margin];
    const numbersOf = (/** @type {Histogram} */ { mean, sd, median, pixel_um: pixel }) =>
      `; mean ${shown(mean)}, SD ${shown(sd)}, median ${shown(median)}${withUnit(values)}; pixels of ${shown(pixel[1])} µm`;
    const beyond = counted?.beyond ? `, ${counted.beyond} beyond` : "";
    const words = counted ? `n ${counted.n}${beyond}${counted.pixel_um ? numbersOf(counted) : ""}` : "not counted yet";
    this.canvas.setAttribute("aria-label", `Histogram of ${values.name}: ${words}`);
    this.track.title = `${values.title}. ${words}. Drag an end; a double click brings both back.`;
    if (untouched) this.limits = this.usual;
    this.write();
  }

  /**
   * Take other limits.
   * @param {number[]} limits low and high
   */
  set(limits) {
    this.limits = limits;
    this.write();
    this.onChange();
  }

  /** Go back to the limits as at the start. */
  reset() {
    this.set(this.usual);
  }

  /**
   * Value at a share of the track.
   * @param {number} share 0 to 1
   * @returns {number}
   */
  at(share) {
    return this.span[0] + Math.max(0, Math.min(1, share)) * (this.span[1] - this.span[0]);
  }

  /** Draw the bar, and write the limits into the field. */
  write() {
    const [low, high] = this.limits;
    this.field.value = this.limits.map(shown).join(", ");
    this.field.setAttribute("aria-invalid", "false");
    this.handles.forEach((handle, k) => {
      const share = (this.limits[k] - this.span[0]) / (this.span[1] - this.span[0] || 1);
      handle.style.left = `${100 * Math.max(0, Math.min(1, share))}%`;
      handle.setAttribute("aria-valuenow", shown(this.limits[k]));
      handle.setAttribute("aria-valuetext", shown(this.limits[k]) + withUnit(this.values));
    });
    const pen = this.canvas.getContext("2d");
    pen.clearRect(0, 0, WIDE, TALL);
    pen.fillStyle = getComputedStyle(this.canvas).color;
    const counts = this.values.counted?.counts ?? [];
    const most = Math.max(1, ...counts);
    counts.forEach((count, k) => {
      const [tall, step] = [(BARS * count) / most, WIDE / counts.length];
      pen.fillRect(k * step, BARS - tall, step, tall);
    });
    for (let x = 0; x < WIDE; x++) {
      const [r, g, b] = this.values.shade((this.at((x + 0.5) / WIDE) - low) / (high - low || 1)).map(Math.round);
      pen.fillStyle = `rgb(${r}, ${g}, ${b})`;
      pen.fillRect(x, BARS, 1, TALL - BARS);
    }
  }

  /**
   * One of both ends.
   * @param {string} name its name for those who do not see it
   * @param {number} k 0 for low, 1 for high
   * @returns {HTMLElement}
   */
  handle(name, k) {
    const handle = make("div", { class: "limit", role: "slider", tabindex: 0, "aria-label": name });
    const move = (value) => {
      const limits = [...this.limits];
      limits[k] = value;
      if (limits[0] < limits[1]) this.set(limits);
    };
    handle.addEventListener("pointerdown", (event) => handle.setPointerCapture(event.pointerId));
    handle.addEventListener("pointermove", (event) => {
      if (!handle.hasPointerCapture(event.pointerId)) return;
      const box = this.track.getBoundingClientRect();
      move(this.at((event.clientX - box.left) / box.width));
    });
    handle.addEventListener("keydown", (event) => {
      const steps = { ArrowLeft: -1, ArrowDown: -1, ArrowRight: 1, ArrowUp: 1 };
      const step = steps[event.key];
      if (!step) return;
      event.preventDefault();
      move(this.limits[k] + (step * (event.shiftKey ? 0.1 : 0.01)) * (this.span[1] - this.span[0]));
    });
    return handle;
  }
}

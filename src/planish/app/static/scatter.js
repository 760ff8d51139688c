/** Two maps against each other: how many pixels have which values, a rectangle that picks some, and the place of the cursor. */

import { make } from "./dom.js";
import { bindGestures } from "./gestures.js";
import { svgOf, viewBar } from "./viewbar.js";

/**
 * @import {Shade} from "./colour.js"
 * @import {Place} from "./gestures.js"
 * @typedef {{label: string, low: number, high: number}} Axis
 * @typedef {{axes: Axis[], wide: number, tall: number, counts: Uint32Array, chosen: Uint32Array|null}} Points
 *   `counts`: pixels in each bin, row by row from the lowest b up; `chosen`: those of them that are selected
 */

const [RIGHT, TOP, BOTTOM] = [14, 8, 40];
const FONT = "12px system-ui, sans-serif";
/** How much closer than all points the view comes, and how much farther off. */
const [CLOSEST, FARTHEST] = [1 / 200, 2];

/**
 * Round numbers within limits.
 * @param {number} low lower limit
 * @param {number} high upper limit
 * @param {number} most how many there may be
 * @returns {number[]}
 */
export function ticks(low, high, most) {
  const power = 10 ** Math.floor(Math.log10((high - low) / most));
  const step = power * ([1, 2, 5, 10].find((one) => (high - low) / (one * power) <= most) ?? 10);
  const found = [];
  for (let k = Math.ceil(low / step); k * step <= high; k++) found.push(Number((k * step).toPrecision(12)));
  return found;
}

export class Scatter {
  /**
   * Make the plot and its tools.
   * @param {object} parts what it is for
   * @param {HTMLElement} parts.element element that gets it
   * @param {Shade} parts.shade colour of a share from 0 to 1
   * @param {(a: number[]|null, b: number[]|null) => void} parts.onBrush called with the values that are picked
   * @param {() => void} parts.onClear called where nothing is to be picked
   */
  constructor({ element, shade, onBrush, onClear }) {
    this.element = element;
    this.shade = shade;
    this.on = { brush: onBrush, clear: onClear };
    this.canvas = make("canvas", { "aria-hidden": "true" });
    this.picture = make("canvas");
    this.bar = viewBar("Scatter", { zoom: (factor) => this.zoom(factor), fit: () => this.fit(), svg: () => this.svg() });
    this.tool = make("button", { type: "button", "aria-pressed": "false", title: "Drag a rectangle; or drag with Shift" }, "Select");
    this.tool.addEventListener("click", () => this.tool.setAttribute("aria-pressed", String(this.tool.ariaPressed !== "true")));
    this.bar.prepend(this.tool);
    element.append(this.canvas);
    this.points = null;
    /** Values that are picked of a and of b; null picks all */
    this.brush = [null, null];
    /** Values at the cursor */
    this.here = null;
    /** Said in place of the points. */
    this.withheld = "";
    /** What is seen, low and high of a and of b. */
    this.seen = [];
    new ResizeObserver(() => this.draw()).observe(element);
    element.addEventListener("keydown", (event) => this.key(event));
    bindGestures(element, {
      pan: (right, down) => this.points && this.pan(right, -down),
      zoom: (factor, at) => this.zoom(factor, at),
      take: (at, shift) => {
        if (!this.points || !(shift || this.tool.ariaPressed === "true")) return null;
        const from = this.valuesAt(at);
        const move = (to) => {
          this.drag = this.valuesAt(to).map((value, k) => [Math.min(value, from[k]), Math.max(value, from[k])]);
          this.draw();
        };
        const cancel = () => {
          this.drag = null;
          this.draw();
        };
        const end = (to) => {
          move(to);
          const [a, b] = this.drag;
          cancel();
          this.on.brush(a, b);
        };
        return { move, end, cancel };
      },
    });
  }

  /**
   * Show other points; the view stays where the axes are the same.
   * @param {Points|null} points null shows none
   * @param {string} [withheld] said in their place
   */
  show(points, withheld = "") {
    const labels = (one) => one?.axes.map((axis) => axis.label).join();
    const same = labels(points) === labels(this.points);
    this.points = points;
    this.withheld = withheld;
    if (points) this.paint(points);
    if (same && this.seen.length) this.draw();
    else this.fit();
  }

  /**
   * The more points, the stronger the colour, by the logarithm; grey where there is a selection beside them.
   * @param {Points} points those that are shown
   */
  paint({ wide, tall, counts, chosen }) {
    const most = Math.log1p(counts.reduce((a, b) => Math.max(a, b), 1));
    const image = new ImageData(wide, tall);
    counts.forEach((count, k) => {
      if (!count) return;
      const share = Math.log1p((chosen ? chosen[k] : count) || count) / most;
      const grey = 205 - 90 * share;
      const colour = chosen && !chosen[k] ? [grey, grey, grey] : this.shade(0.08 + 0.92 * share);
      image.data.set([...Array.from(colour), 255], 4 * ((tall - 1 - Math.floor(k / wide)) * wide + (k % wide)));
    });
    [this.picture.width, this.picture.height] = [wide, tall];
    this.picture.getContext("2d").putImageData(image, 0, 0);
  }

  // --- where the view is -----------------------------------------------------------------------------------------

  /** Show all points. */
  fit() {
    if (this.points) this.seen = this.points.axes.map(({ low, high }) => [low, high]);
    this.draw();
  }

  /**
   * Move the view.
   * @param {number} right in screen pixels
   * @param {number} up in screen pixels
   */
  pan(right, up) {
    const [, , wide, tall] = this.area();
    this.seen = this.seen.map(([low, high], k) => {
      const by = ((high - low) * (k ? up / tall : right / wide));
      return [low - by, high - by];
    });
    this.draw();
  }

  /**
   * Zoom about a place.
   * @param {number} factor above 1 comes closer
   * @param {Place} [at] place on the screen that stays; the middle where it is not given
   */
  zoom(factor, at) {
    if (!this.points) return;
    const { axes } = this.points;
    const span = axes[0].high - axes[0].low;
    const now = this.seen[0][1] - this.seen[0][0];
    const by = Math.max(CLOSEST * span, Math.min(FARTHEST * span, now / factor)) / now;
    const about = at ? this.valuesAt(at) : this.seen.map(([low, high]) => (low + high) / 2);
    this.seen = this.seen.map((range, k) => range.map((value) => about[k] + (value - about[k]) * by));
    this.draw();
  }

  /**
   * The plot on the screen: left, top, width and height.
   * @returns {[number, number, number, number]}
   */
  area() {
    const { clientWidth: wide, clientHeight: tall } = this.element;
    const pen = this.canvas.getContext("2d");
    pen.font = FONT;
    const widest = Math.max(0, ...this.ticks(1).map((tick) => pen.measureText(String(tick)).width));
    const left = 30 + widest;
    return [left, TOP, Math.max(wide - left - RIGHT, 10), Math.max(tall - TOP - BOTTOM, 10)];
  }

  /**
   * Round numbers of an axis.
   * @param {number} k 0 for a, 1 for b
   * @returns {number[]}
   */
  ticks(k) {
    const [low, high] = this.seen[k];
    return ticks(low, high, Math.max(2, k ? this.element.clientHeight / 35 : this.element.clientWidth / 70));
  }

  /**
   * The values at a place of the view.
   * @param {Place} at on the screen
   * @returns {[number, number]}
   */
  valuesAt([x, y]) {
    const [left, top, wide, tall] = this.area();
    const [[a0, a1], [b0, b1]] = this.seen;
    return [a0 + ((x - left) / wide) * (a1 - a0), b1 - ((y - top) / tall) * (b1 - b0)];
  }

  /**
   * The place of values in the view.
   * @param {number[]} values of a and of b
   * @returns {Place}
   */
  placeOf([a, b]) {
    const [left, top, wide, tall] = this.area();
    const [[a0, a1], [b0, b1]] = this.seen;
    return [left + (wide * (a - a0)) / (a1 - a0), top + (tall * (b1 - b)) / (b1 - b0)];
  }

  // --- drawing ---------------------------------------------------------------------------------------------------

  /** Draw the plot. */
  draw() {
    const { clientWidth: wide, clientHeight: tall } = this.element;
    if (!wide) return;
    const ratio = Math.min(window.devicePixelRatio || 1, 2);
    [this.canvas.width, this.canvas.height] = [Math.round(wide * ratio), Math.round(tall * ratio)];
    const pen = this.canvas.getContext("2d");
    pen.scale(ratio, ratio);
    const ink = getComputedStyle(this.element).color;
    pen.font = FONT;
    pen.fillStyle = pen.strokeStyle = ink;
    if (this.withheld || !this.points) {
      pen.fillText(this.withheld, 12, TOP + 20, wide - 24);
      return;
    }
    const [left, top, width, height] = this.area();
    const { axes } = this.points;
    pen.save();
    pen.beginPath();
    pen.rect(left, top, width, height);
    pen.clip();
    pen.imageSmoothingEnabled = false;
    const [x0, y0] = this.placeOf([axes[0].low, axes[1].high]);
    const [x1, y1] = this.placeOf([axes[0].high, axes[1].low]);
    pen.drawImage(this.picture, x0, y0, x1 - x0, y1 - y0);
    this.drawBrush(pen);
    if (this.here?.every(Number.isFinite)) {
      const [x, y] = this.placeOf(this.here);
      stroked(pen, () => pen.arc(x, y, 5, 0, 7));
    }
    pen.restore();
    pen.strokeRect(left + 0.5, top + 0.5, width, height);
    pen.textAlign = "center";
    for (const tick of this.ticks(0)) pen.fillText(String(tick), this.placeOf([tick, 0])[0], top + height + 15);
    pen.fillText(axes[0].label, left + width / 2, tall - 6, wide - 10);
    pen.textAlign = "right";
    for (const tick of this.ticks(1)) pen.fillText(String(tick), left - 5, this.placeOf([0, tick])[1] + 4);
    pen.textAlign = "center";
    pen.translate(13, top + height / 2);
    pen.rotate(-Math.PI / 2);
    pen.fillText(axes[1].label, 0, 0, tall - 10);
  }

  /**
   * Draw the rectangle that is picked.
   * @param {CanvasRenderingContext2D} pen of the plot
   */
  drawBrush(pen) {
    const [a, b] = this.drag ?? this.brush;
    if (!a && !b) return;
    const [x0, y1] = this.placeOf([(a ?? this.seen[0])[0], (b ?? this.seen[1])[0]]);
    const [x1, y0] = this.placeOf([(a ?? this.seen[0])[1], (b ?? this.seen[1])[1]]);
    stroked(pen, () => pen.rect(x0, y0, x1 - x0, y1 - y0), "#c22");
  }

  /**
   * The plot as it is seen.
   * @returns {string} as SVG
   */
  svg() {
    this.draw();
    const { clientWidth: wide, clientHeight: tall } = this.element;
    const whole = make("canvas", { width: this.canvas.width, height: this.canvas.height });
    const pen = whole.getContext("2d");
    pen.fillStyle = getComputedStyle(this.element).backgroundColor;
    pen.fillRect(0, 0, whole.width, whole.height);
    pen.drawImage(this.canvas, 0, 0);
    return svgOf(whole, { wide, tall, title: this.points?.axes.map((axis) => axis.label).join(" and ") ?? "" });
  }

  // --- keys ------------------------------------------------------------------------------------------------------

  /**
   * A key of the plot.
   * @param {KeyboardEvent} event the key
   */
  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || !this.points || event.target !== this.element) return;
    const arrows = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
    const step = arrows[event.key];
    if (step) this.arrow(step, event.shiftKey);
    else if (event.key === "Enter") {
      const [a, b] = this.seen.map(([low, high]) => [low + 0.4 * (high - low), low + 0.6 * (high - low)]);
      this.on.brush(a, b);
    } else if (event.key === "Escape") this.on.clear();
    else if (event.key === "+" || event.key === "=") this.zoom(Math.SQRT2);
    else if (event.key === "-" || event.key === "−") this.zoom(Math.SQRT1_2);
    else if (event.key === "0") this.fit();
    else return;
    event.preventDefault();
  }

  /**
   * Move the rectangle, or with Shift its upper right corner; where there is none, the view.
   * @param {number[]} step to the right and up
   * @param {boolean} grow whether the corner alone is moved
   * @returns {void}
   */
  arrow(step, grow) {
    const [a, b] = this.brush;
    if (!a && !b) return this.pan(-20 * step[0], -20 * step[1]);
    const moved = [a, b].map((range, k) => {
      const [low, high] = range ?? this.seen[k];
      const by = 0.02 * step[k] * (this.seen[k][1] - this.seen[k][0]);
      return [grow ? low : low + by, Math.max(high + by, low + 1e-9)];
    });
    this.on.brush(moved[0], moved[1]);
  }
}

/**
 * A line that is seen on any ground.
 * @param {CanvasRenderingContext2D} pen where it is drawn
 * @param {() => void} path adds the line to the path
 * @param {string} [colour] of the line on its white ground
 */
function stroked(pen, path, colour = "#111") {
  for (const [ink, width] of /** @type {[string, number][]} */ ([["#fff", 4], [colour, 1.8]])) {
    pen.strokeStyle = ink;
    pen.lineWidth = width;
    pen.beginPath();
    path();
    pen.stroke();
  }
}

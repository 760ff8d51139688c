/** Two layers against each other: density of the points, a rectangle that picks values, and the points of a region. */

import { CHOSEN, colourAt, packed } from "./colour.js";
import { labelled, make, numbers, positive } from "./dom.js";

const EDGE = { left: 62, right: 10, top: 10, bottom: 38 };
const ARROWS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };
/** Screen pixels of a drag that picks something. */
const LEAST_PX = 3;

/**
 * @typedef {{bins: number, a_low: number, a_high: number, b_low: number, b_high: number, counts: string,
 *   n: number, beyond: number, pixel_um: number[]}} Density
 */

/** Counts of a density, row by row from the lowest b up. @param {Density} density @returns {Uint32Array} */
const countsOf = ({ counts }) => new Uint32Array(Uint8Array.from(atob(counts), (one) => one.charCodeAt(0)).buffer);

/**
 * Points as an image, one pixel a bin: the more points, the stronger the colour, by the logarithm.
 * @param {Density} density
 * @param {(share: number) => number} colour
 */
function imageOf(density, colour) {
  const counts = countsOf(density);
  const side = density.bins;
  const canvas = make("canvas", { width: side, height: side });
  const context = canvas.getContext("2d");
  const image = context.createImageData(side, side);
  const pixels = new Uint32Array(image.data.buffer);
  const most = Math.log1p(counts.reduce((a, b) => Math.max(a, b), 1));
  counts.forEach((count, i) => {
    const row = side - 1 - Math.floor(i / side);
    if (count) pixels[row * side + (i % side)] = colour(Math.log1p(count) / most);
  });
  context.putImageData(image, 0, 0);
  return canvas;
}

/** Round numbers within limits. @param {number} low @param {number} high @param {number} most */
export function ticks(low, high, most) {
  const power = 10 ** Math.floor(Math.log10((high - low) / most));
  const step = power * ([1, 2, 5, 10].find((one) => (high - low) / (one * power) <= most) ?? 10);
  const found = [];
  for (let k = Math.ceil(low / step); k * step <= high; k++) found.push(Number((k * step).toPrecision(12)));
  return found;
}

export class Scatter {
  /** @param {{onBrush: (a: number[], b: number[]) => void, onClear: () => void, say: (text: string) => void}} listener */
  constructor(listener) {
    this.listener = listener;
    this.canvas = make("canvas", { "aria-hidden": "true" });
    this.element = make("div", { class: "map scatter", role: "application", "aria-label": "Scatter", tabindex: 0 }, this.canvas);
    this.centreField = make("input", { type: "text", size: 16, spellcheck: "false" });
    this.pixelField = make("input", { type: "number", min: 0, step: "any" });
    this.fields = make(
      "div",
      { class: "fields" },
      labelled("centre, um", this.centreField, "Scatter "),
      labelled("um per screen pixel", this.pixelField, "Scatter, "),
    );
    /** @type {Density|null} */
    this.density = null;
    this.names = ["", ""];
    /** @type {number[][]|null} */
    this.brush = null;
    /** @type {number[]|null} */
    this.drag = null;
    this.bind();
    new ResizeObserver(() => this.draw()).observe(this.element);
  }

  /**
   * Show how the points of two layers lie.
   * @param {Density} density
   * @param {string[]} names of the layers with their units
   */
  show(density, names) {
    const same = this.names.join() === names.join();
    this.density = density;
    this.names = names;
    this.points = imageOf(density, (share) => packed(colourAt("viridis", 0.08 + 0.92 * share)));
    this.region = null;
    if (!same) this.fit();
    this.draw();
  }

  /** Show the points of a region over the others. @param {Density|null} density */
  showRegion(density) {
    this.region = density && imageOf(density, (share) => packed(CHOSEN, 90 + Math.round(165 * share)));
    this.draw();
  }

  /** Show the values that are picked, of a and of b; null picks all. @param {(number[]|null)[]} ranges */
  showBrush([a, b]) {
    this.brush = a || b ? [a ?? [-Infinity, Infinity], b ?? [-Infinity, Infinity]] : null;
    this.draw();
  }

  // --- where the view is -----------------------------------------------------------------------------------------

  /** Width and height of the plot on the screen. */
  get size() {
    const { clientWidth, clientHeight } = this.element;
    return [Math.max(clientWidth - EDGE.left - EDGE.right, 10), Math.max(clientHeight - EDGE.top - EDGE.bottom, 10)];
  }

  fit() {
    if (!this.density) return;
    const { a_low, a_high, b_low, b_high } = this.density;
    const [width, height] = this.size;
    this.centre = [(a_low + a_high) / 2, (b_low + b_high) / 2];
    this.ratio = (b_high - b_low) / height / ((a_high - a_low) / width);
    this.pixel = (a_high - a_low) / width;
  }

  /** The values at a place of the canvas. @param {number} x @param {number} y @returns {number[]} */
  valuesAt(x, y) {
    const [width, height] = this.size;
    return [
      this.centre[0] + (x - EDGE.left - width / 2) * this.pixel,
      this.centre[1] - (y - EDGE.top - height / 2) * this.pixel * this.ratio,
    ];
  }

  /** The place of values on the canvas. @param {number[]} values @returns {number[]} */
  placeOf([a, b]) {
    const [width, height] = this.size;
    return [
      EDGE.left + width / 2 + (a - this.centre[0]) / this.pixel,
      EDGE.top + height / 2 - (b - this.centre[1]) / (this.pixel * this.ratio),
    ];
  }

  // --- drawing ---------------------------------------------------------------------------------------------------

  draw() {
    if (!this.density || !this.element.clientWidth) return;
    if (!Number.isFinite(this.pixel)) this.fit();
    const { clientWidth: wide, clientHeight: high } = this.element;
    const dense = window.devicePixelRatio || 1;
    this.canvas.width = wide * dense;
    this.canvas.height = high * dense;
    this.canvas.style.width = `${wide}px`;
    this.canvas.style.height = `${high}px`;
    const context = this.canvas.getContext("2d");
    const [width, height] = this.size;
    const style = getComputedStyle(this.element);
    context.setTransform(dense, 0, 0, dense, 0, 0);
    context.font = `12px ${style.fontFamily}`;
    context.save();
    context.beginPath();
    context.rect(EDGE.left, EDGE.top, width, height);
    context.clip();
    this.paint(context, this.points, this.region ? 0.35 : 1);
    if (this.region) this.paint(context, this.region, 1);
    const box = this.drag ? this.dragged() : this.brush;
    if (box) this.frame(context, box);
    context.restore();
    this.axes(context, style.color);
    this.showPlace();
  }

  paint(context, image, alpha) {
    const { a_low, a_high, b_low, b_high } = /** @type {Density} */ (this.density);
    const [left, top] = this.placeOf([a_low, b_high]);
    const [right, bottom] = this.placeOf([a_high, b_low]);
    context.imageSmoothingEnabled = false;
    context.globalAlpha = alpha;
    context.drawImage(image, left, top, right - left, bottom - top);
    context.globalAlpha = 1;
  }

  frame(context, [a, b]) {
    const [width, height] = this.size;
    const within = (value, low, size) => Math.min(Math.max(value, low - 2), low + size + 2);
    const [x0, y0] = this.placeOf([a[0], b[1]]).map((v, k) => within(v, [EDGE.left, EDGE.top][k], [width, height][k]));
    const [x1, y1] = this.placeOf([a[1], b[0]]).map((v, k) => within(v, [EDGE.left, EDGE.top][k], [width, height][k]));
    context.fillStyle = `rgba(${CHOSEN.join()}, 0.14)`;
    context.strokeStyle = `rgb(${CHOSEN.join()})`;
    context.lineWidth = 2;
    context.fillRect(x0, y0, x1 - x0, y1 - y0);
    context.strokeRect(x0, y0, x1 - x0, y1 - y0);
  }

  axes(context, colour) {
    const [width, height] = this.size;
    const [low, high] = [this.valuesAt(EDGE.left, EDGE.top + height), this.valuesAt(EDGE.left + width, EDGE.top)];
    context.fillStyle = context.strokeStyle = colour;
    context.lineWidth = 1;
    context.strokeRect(EDGE.left + 0.5, EDGE.top + 0.5, width - 1, height - 1);
    context.textAlign = "center";
    for (const tick of ticks(low[0], high[0], Math.max(2, width / 80))) {
      context.fillText(String(tick), this.placeOf([tick, 0])[0], EDGE.top + height + 14);
    }
    context.fillText(this.names[0], EDGE.left + width / 2, EDGE.top + height + 31);
    context.textAlign = "right";
    for (const tick of ticks(low[1], high[1], Math.max(2, height / 40))) {
      context.fillText(String(tick), EDGE.left - 6, this.placeOf([0, tick])[1] + 4);
    }
    context.save();
    context.translate(12, EDGE.top + height / 2);
    context.rotate(-Math.PI / 2);
    context.textAlign = "center";
    context.fillText(this.names[1], 0, 0);
    context.restore();
  }

  showPlace() {
    const focused = document.activeElement;
    if (this.centreField !== focused) this.centreField.value = this.centre.map((v) => Number(v.toPrecision(7))).join(", ");
    if (this.pixelField !== focused) this.pixelField.value = String(Number(this.pixel.toPrecision(5)));
  }

  // --- mouse, keys and fields ------------------------------------------------------------------------------------

  dragged() {
    const [x0, y0, x1, y1] = /** @type {number[]} */ (this.drag);
    const [from, to] = [this.valuesAt(x0, y0), this.valuesAt(x1, y1)];
    return [0, 1].map((k) => [Math.min(from[k], to[k]), Math.max(from[k], to[k])]);
  }

  bind() {
    const at = (/** @type {MouseEvent} */ event) => {
      const box = this.element.getBoundingClientRect();
      return [event.clientX - box.left, event.clientY - box.top];
    };
    this.element.addEventListener("pointerdown", (event) => {
      if (event.button !== 0 || !this.density) return;
      this.element.setPointerCapture(event.pointerId);
      const [x, y] = at(event);
      this.drag = [x, y, x, y];
    });
    this.element.addEventListener("pointermove", (event) => {
      if (!this.drag) return;
      this.drag = [this.drag[0], this.drag[1], ...at(event)];
      this.draw();
    });
    this.element.addEventListener("pointerup", () => {
      if (!this.drag) return;
      const [x0, y0, x1, y1] = this.drag;
      const picked = this.dragged();
      this.drag = null;
      if (Math.abs(x1 - x0) > LEAST_PX && Math.abs(y1 - y0) > LEAST_PX) this.listener.onBrush(picked[0], picked[1]);
      this.draw();
    });
    this.element.addEventListener("pointercancel", () => {
      this.drag = null;
      this.draw();
    });
    this.element.addEventListener(
      "wheel",
      (event) => {
        if (!this.density) return;
        event.preventDefault();
        this.zoom(Math.exp(event.deltaY / 400), at(event));
      },
      { passive: false },
    );
    this.element.addEventListener("keydown", (event) => this.key(event));
    const place = (/** @type {string} */ text) => numbers(text, 2);
    this.field(this.centreField, place, (point) => (this.centre = point), 'Scatter centre is "x, y": a value of each layer.');
    this.field(this.pixelField, positive, ([um]) => (this.pixel = um), "Scatter: um per screen pixel is a number above 0.");
  }

  /**
   * @param {HTMLInputElement} field
   * @param {(text: string) => number[]|null} read
   * @param {(values: number[]) => void} use
   * @param {string} needed
   */
  field(field, read, use, needed) {
    field.addEventListener("change", () => {
      const values = read(field.value);
      field.setAttribute("aria-invalid", String(!values));
      if (!values) return this.listener.say(needed);
      use(values);
      this.draw();
    });
  }

  /** @param {KeyboardEvent} event */
  key(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || !this.density) return;
    const step = ARROWS[/** @type {keyof typeof ARROWS} */ (event.key)];
    if (step) {
      event.preventDefault();
      const pixels = event.shiftKey ? 50 : 10;
      this.centre = [
        this.centre[0] + step[0] * pixels * this.pixel,
        this.centre[1] + step[1] * pixels * this.pixel * this.ratio,
      ];
    } else if (event.key === "+" || event.key === "=") return this.zoom(Math.SQRT1_2);
    else if (event.key === "-") return this.zoom(Math.SQRT2);
    else if (event.key === "0") this.fit();
    else if (event.key === "Escape") return this.listener.onClear();
    this.draw();
  }

  /** @param {number} factor @param {number[]} [about] place on the canvas that stays */
  zoom(factor, about) {
    const [width, height] = this.size;
    const [x, y] = about ?? [EDGE.left + width / 2, EDGE.top + height / 2];
    const before = this.valuesAt(x, y);
    this.pixel *= factor;
    const after = this.valuesAt(x, y);
    this.centre = [this.centre[0] + before[0] - after[0], this.centre[1] + before[1] - after[1]];
    this.draw();
  }
}

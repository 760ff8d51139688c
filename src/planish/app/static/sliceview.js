/** The picture of a slice: pixels, lines to the screen pixel, pan, zoom, a cursor for mouse and keys. */

import { make } from "./dom.js";
import { along, placeAt } from "./slicedata.js";
import { drawOver } from "./sliceover.js";

const CLOSEST = 64; // screen pixels of a voxel
const CLICK_PX = 4; // a mouse that moves farther drags

export class SliceView {
  /**
   * @param {{onCursor: (place: {across: number, down: number}|null) => void,
   *   onPoint: (place: {across: number, down: number}) => void, onStep: (by: number) => void, onBack: () => void}} on
   */
  constructor(on) {
    this.on = on;
    this.canvas = make("canvas", { role: "img", "aria-label": "Slice", tabindex: "0", class: "slice" });
    this.frame = make("div", { class: "slice-frame" }, this.canvas);
    /** @type {import("./slicedata.js").Slice|null} */
    this.slice = null;
    /** @type {HTMLCanvasElement} */
    this.grey = document.createElement("canvas");
    this.shown = new Set(["faces", "interfaces", "centre"]);
    /** @type {{across: number, down: number, face: string, draft: boolean, here: boolean}[]} */
    this.points = [];
    this.zoom = 0; // screen pixels a um
    this.isWhole = false;
    this.acrossIsRows = false; // whether the slice runs along the rows' axis
    this.left = 0; // um from the first pixel at the canvas' left and upper edge
    this.upper = 0;
    /** @type {{x: number, y: number}|null} */
    this.cursor = null;
    /** @type {[number, number]|null} */
    this.range = null;
    new ResizeObserver(() => this.resized()).observe(this.frame);
    this.bind();
  }

  /** Show a slice; the view stays where it is unless another plane is shown. @param {import("./slicedata.js").Slice} slice */
  show(slice) {
    const key = (/** @type {import("./slicedata.js").Slice|null} */ s) =>
      s && [s.facts.layer, s.facts.direction, s.facts.across.count, s.facts.down.count].join();
    const other = key(slice) !== key(this.slice);
    this.slice = slice;
    this.paintGrey();
    if (other || !this.zoom) this.whole();
    else this.draw();
    if (this.cursor) this.say();
  }

  paintGrey() {
    if (!this.slice) return;
    const { across, down, missing } = this.slice.facts;
    const [low, high] = this.range ?? this.slice.usual();
    const image = new ImageData(across.count, down.count);
    const words = new Uint32Array(image.data.buffer);
    const factor = 255 / (high - low || 1);
    this.slice.pixels.forEach((code, k) => {
      const level = Math.max(0, Math.min(255, Math.round((code - low) * factor)));
      words[k] = code === missing ? 0xff5a3a2a : 0xff000000 | (level << 16) | (level << 8) | level;
    });
    this.grey.width = across.count;
    this.grey.height = down.count;
    /** @type {CanvasRenderingContext2D} */ (this.grey.getContext("2d")).putImageData(image, 0, 0);
  }

  /** Size of the slice in um. @returns {[number, number]} */
  size() {
    const { across, down } = /** @type {import("./slicedata.js").Slice} */ (this.slice).facts;
    return [across.count * Math.abs(across.step_um), down.count * Math.abs(down.step_um)];
  }

  whole() {
    if (!this.slice || !this.canvas.clientWidth) return;
    const [wide, high] = this.size();
    this.zoom = Math.min(this.canvas.clientWidth / wide, this.canvas.clientHeight / high);
    this.centre(wide / 2, high / 2);
    this.isWhole = true;
  }

  /** Bring a distance from the first pixel to the middle. @param {number} a @param {number} b */
  centre(a, b) {
    const { across, down } = /** @type {import("./slicedata.js").Slice} */ (this.slice).facts;
    this.left = a - Math.abs(across.step_um) / 2 - this.canvas.clientWidth / this.zoom / 2;
    this.upper = b - Math.abs(down.step_um) / 2 - this.canvas.clientHeight / this.zoom / 2;
    this.isWhole = false;
    this.draw();
  }

  /** Show a place at a scale. @param {number} across @param {number} down @param {number} [zoom] */
  goTo(across, down, zoom) {
    if (!this.slice) return;
    if (zoom) this.zoom = zoom;
    const { facts } = this.slice;
    const [a, b] = [along(facts.across, across), along(facts.down, down)];
    this.centre(a + Math.abs(facts.across.step_um) / 2, b + Math.abs(facts.down.step_um) / 2);
    this.cursor = { x: this.canvas.clientWidth / 2, y: this.canvas.clientHeight / 2 };
    this.say();
    this.draw();
  }

  /** @param {number} factor @param {number} x @param {number} y place on the screen that stays */
  zoomBy(factor, x, y) {
    if (!this.slice) return;
    const [wide] = this.size();
    const finest = CLOSEST / Math.abs(this.slice.facts.across.step_um);
    const next = Math.max(Math.min(this.zoom * factor, finest), (0.5 * this.canvas.clientWidth) / wide);
    this.left += x / this.zoom - x / next;
    this.upper += y / this.zoom - y / next;
    this.zoom = next;
    this.isWhole = false;
    this.draw();
  }

  /** Place in the slice of a place on the screen, in um along its axes. @param {number} x @param {number} y */
  placeOf(x, y) {
    const { across, down } = /** @type {import("./slicedata.js").Slice} */ (this.slice).facts;
    return { across: placeAt(across, this.left + x / this.zoom), down: placeAt(down, this.upper + y / this.zoom) };
  }

  /** @param {number} across @param {number} down @returns {[number, number]} */
  onScreen(across, down) {
    const { facts } = /** @type {import("./slicedata.js").Slice} */ (this.slice);
    return [
      (along(facts.across, across) - this.left) * this.zoom,
      (along(facts.down, down) - this.upper) * this.zoom,
    ];
  }

  say() {
    this.on.onCursor(this.cursor && this.slice ? this.placeOf(this.cursor.x, this.cursor.y) : null);
  }

  resized() {
    const ratio = window.devicePixelRatio || 1;
    const { clientWidth, clientHeight } = this.frame;
    this.canvas.width = Math.round(clientWidth * ratio);
    this.canvas.height = Math.round(clientHeight * ratio);
    if (this.slice && (this.isWhole || !this.zoom)) this.whole();
    else this.draw();
  }

  // --- drawing -------------------------------------------------------------------------------------------------

  draw() {
    const pen = /** @type {CanvasRenderingContext2D} */ (this.canvas.getContext("2d"));
    const ratio = this.canvas.width / (this.canvas.clientWidth || 1);
    pen.setTransform(ratio, 0, 0, ratio, 0, 0);
    pen.clearRect(0, 0, this.canvas.clientWidth, this.canvas.clientHeight);
    if (!this.slice || !this.zoom) return;
    const { across, down } = this.slice.facts;
    const [wide, high] = [Math.abs(across.step_um) * this.zoom, Math.abs(down.step_um) * this.zoom];
    pen.imageSmoothingEnabled = wide < 1;
    pen.drawImage(
      this.grey, -this.left * this.zoom - wide / 2, -this.upper * this.zoom - high / 2,
      wide * across.count, high * down.count,
    );
    drawOver(this, pen);
  }

  // --- mouse and keys ------------------------------------------------------------------------------------------

  bind() {
    const { canvas } = this;
    /** @type {{x: number, y: number, left: number, upper: number, moved: boolean}|null} */
    let held = null;
    canvas.addEventListener("pointerdown", (/** @type {PointerEvent} */ event) => {
      if (event.button !== 0) return;
      held = { x: event.offsetX, y: event.offsetY, left: this.left, upper: this.upper, moved: false };
      canvas.setPointerCapture(event.pointerId);
    });
    canvas.addEventListener("pointermove", (/** @type {PointerEvent} */ event) => {
      this.cursor = { x: event.offsetX, y: event.offsetY };
      if (held) {
        held.moved ||= Math.hypot(event.offsetX - held.x, event.offsetY - held.y) > CLICK_PX;
        if (held.moved) {
          this.isWhole = false;
          this.left = held.left - (event.offsetX - held.x) / this.zoom;
          this.upper = held.upper - (event.offsetY - held.y) / this.zoom;
          this.draw();
        }
      }
      this.say();
    });
    canvas.addEventListener("pointerup", (/** @type {PointerEvent} */ event) => {
      const clicked = held && !held.moved;
      held = null;
      if (clicked && this.slice) this.on.onPoint(this.placeOf(event.offsetX, event.offsetY));
    });
    canvas.addEventListener("pointercancel", () => (held = null));
    canvas.addEventListener("wheel", (/** @type {WheelEvent} */ event) => {
      event.preventDefault();
      this.zoomBy(Math.exp(-Math.max(-200, Math.min(200, event.deltaY)) / 300), event.offsetX, event.offsetY);
      this.say();
    }, { passive: false });
    canvas.addEventListener("keydown", (/** @type {KeyboardEvent} */ event) => this.key(event));
    canvas.addEventListener("focus", () => this.draw());
    canvas.addEventListener("blur", () => this.draw());
  }

  /** @param {KeyboardEvent} event */
  key(event) {
    if (!this.slice || event.ctrlKey || event.metaKey || event.altKey) return;
    const { clientWidth, clientHeight } = this.canvas;
    this.cursor ??= { x: clientWidth / 2, y: clientHeight / 2 };
    const step = event.shiftKey ? 5 : 1;
    const moves = { ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, -step], ArrowDown: [0, step] };
    const move = moves[/** @type {keyof typeof moves} */ (event.key)];
    if (move) this.moveCursor(move[0], move[1]);
    else if (event.key === "+" || event.key === "=") this.zoomBy(1.25, this.cursor.x, this.cursor.y);
    else if (event.key === "-") this.zoomBy(0.8, this.cursor.x, this.cursor.y);
    else if (event.key === "Home") this.whole();
    else if (event.key === "PageDown") this.on.onStep(event.shiftKey ? 10 : 1);
    else if (event.key === "PageUp") this.on.onStep(event.shiftKey ? -10 : -1);
    else if (event.key === "Enter") this.on.onPoint(this.placeOf(this.cursor.x, this.cursor.y));
    else if (event.key === "Backspace") this.on.onBack();
    else return;
    event.preventDefault();
    this.say();
    this.draw();
  }

  /** Move the cursor; at an edge the slice moves under it. @param {number} x @param {number} y */
  moveCursor(x, y) {
    const cursor = /** @type {{x: number, y: number}} */ (this.cursor);
    const next = { x: cursor.x + x, y: cursor.y + y };
    this.cursor = {
      x: Math.max(0, Math.min(this.canvas.clientWidth, next.x)),
      y: Math.max(0, Math.min(this.canvas.clientHeight, next.y)),
    };
    this.left += (next.x - this.cursor.x) / this.zoom;
    this.upper += (next.y - this.cursor.y) / this.zoom;
  }
}

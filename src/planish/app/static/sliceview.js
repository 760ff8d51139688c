/** The picture of a slice: pixels, lines to the screen pixel, pan, zoom, a cursor for mouse and keys. */

import { make } from "./dom.js";
import { bindGestures } from "./gestures.js";
import { along, placeAt } from "./slicedata.js";
import { drawOver } from "./sliceover.js";
import { drawScaleBar, lengthWords, roundLength, svgOf, viewBar } from "./viewbar.js";

/**
 * @import {Held, Place} from "./gestures.js"
 * @import {Slice, SlicePlace} from "./slicedata.js"
 */

const CLOSEST = 64; // screen pixels of a voxel

export class SliceView {
  /**
   * Make the view.
   * @param {object} on what is called
   * @param {(at: SlicePlace|null) => void} on.onCursor the cursor moves, or leaves the slice
   * @param {(at: SlicePlace) => void} on.onPoint a place is clicked
   * @param {(by: number) => void} on.onStep a slice before or behind is wanted
   * @param {() => void} on.onBack the last point is to go
   */
  constructor(on) {
    this.on = on;
    this.canvas = make("canvas", { role: "img", "aria-label": "Slice", tabindex: "0", class: "slice" });
    const zoom = (factor) => this.zoomBy(factor, this.canvas.clientWidth / 2, this.canvas.clientHeight / 2);
    this.frame = make("div", { class: "slice-frame" }, this.canvas, viewBar("Slice", { zoom, fit: () => this.whole(), svg: () => this.svg() }));
    /** The place that was chosen */
    this.marked = null;
    this.slice = null;
    this.grey = document.createElement("canvas");
    this.shown = new Set(["faces", "interfaces", "centre"]);
    this.points = [];
    this.zoom = 0; // screen pixels a um
    this.isWhole = false;
    this.acrossIsRows = false; // whether the slice runs along the rows' axis
    this.left = 0; // um from the first pixel at the canvas' left and upper edge
    this.upper = 0;
    this.cursor = null;
    /** Codes that are black and white. */
    this.range = [0, 1];
    /** Takes the codes that a drag with Shift chose */
    this.onWindow = null;
    new ResizeObserver(() => this.resized()).observe(this.frame);
    this.bind();
  }

  /**
   * Show a slice; the view stays where it is unless another plane is shown.
   * @param {Slice} slice the slice
   */
  show(slice) {
    const key = (s) =>
      s && [s.facts.layer, s.facts.direction, s.facts.across.count, s.facts.down.count].join();
    const other = key(slice) !== key(this.slice);
    this.slice = slice;
    this.paintGrey();
    if (other || !this.zoom) this.whole();
    else this.draw();
    if (this.cursor) this.say();
  }

  /** Give each pixel its grey. */
  paintGrey() {
    if (!this.slice) return;
    const { across, down, missing } = this.slice.facts;
    const [low, high] = this.range;
    const image = new ImageData(across.count, down.count);
    const words = new Uint32Array(image.data.buffer);
    const factor = 255 / (high - low || 1);
    this.slice.pixels.forEach((code, k) => {
      const level = Math.max(0, Math.min(255, Math.round((code - low) * factor)));
      words[k] = code === missing ? 0xff5a3a2a : 0xff000000 | (level << 16) | (level << 8) | level;
    });
    this.grey.width = across.count;
    this.grey.height = down.count;
    this.grey.getContext("2d").putImageData(image, 0, 0);
  }

  /**
   * Size of the slice in um.
   * @returns {[number, number]}
   */
  size() {
    const { across, down } = this.slice.facts;
    return [across.count * Math.abs(across.step_um), down.count * Math.abs(down.step_um)];
  }

  /** Show the whole slice. */
  whole() {
    if (!this.slice || !this.canvas.clientWidth) return;
    const [wide, high] = this.size();
    this.zoom = Math.min(this.canvas.clientWidth / wide, this.canvas.clientHeight / high);
    this.centre(wide / 2, high / 2);
    this.isWhole = true;
  }

  /**
   * Bring a distance from the first pixel to the middle.
   * @param {number} a um across
   * @param {number} b um down
   */
  centre(a, b) {
    const { across, down } = this.slice.facts;
    this.left = a - Math.abs(across.step_um) / 2 - this.canvas.clientWidth / this.zoom / 2;
    this.upper = b - Math.abs(down.step_um) / 2 - this.canvas.clientHeight / this.zoom / 2;
    this.isWhole = false;
    this.draw();
  }

  /**
   * Bring a place into the middle.
   * @param {number} across um along the slice
   * @param {number} down um through it
   * @param {number} [zoom] screen pixels a um; as it is where it is not given
   */
  lookAt(across, down, zoom) {
    if (!this.slice) return;
    if (zoom) this.zoom = zoom;
    const { facts } = this.slice;
    const [a, b] = [along(facts.across, across), along(facts.down, down)];
    this.centre(a + Math.abs(facts.across.step_um) / 2, b + Math.abs(facts.down.step_um) / 2);
  }

  /**
   * Show a place at a scale, and mark it.
   * @param {number} across um along the slice
   * @param {number} down um through it
   * @param {number} zoom screen pixels a um
   */
  goTo(across, down, zoom) {
    if (!this.slice) return;
    this.marked = { across, down };
    this.lookAt(across, down, zoom);
    this.cursor = { x: this.canvas.clientWidth / 2, y: this.canvas.clientHeight / 2 };
    this.say();
    this.draw();
  }

  /**
   * Zoom about a place.
   * @param {number} factor above 1 comes closer
   * @param {number} x place on the screen that stays, to the right
   * @param {number} y place on the screen that stays, down
   */
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

  /**
   * Place in the slice of a place on the screen, in um along its axes.
   * @param {number} x to the right
   * @param {number} y down
   * @returns {SlicePlace}
   */
  placeOf(x, y) {
    const { across, down } = this.slice.facts;
    return { across: placeAt(across, this.left + x / this.zoom), down: placeAt(down, this.upper + y / this.zoom) };
  }

  /**
   * Place on the screen of a place in the slice.
   * @param {number} across um along the slice
   * @param {number} down um through it
   * @returns {[number, number]}
   */
  onScreen(across, down) {
    const { facts } = this.slice;
    return [
      (along(facts.across, across) - this.left) * this.zoom,
      (along(facts.down, down) - this.upper) * this.zoom,
    ];
  }

  /** Tell where the cursor is. */
  say() {
    this.on.onCursor(this.cursor && this.slice ? this.placeOf(this.cursor.x, this.cursor.y) : null);
  }

  /** Fit the picture to the frame. */
  resized() {
    const ratio = window.devicePixelRatio || 1;
    const { clientWidth, clientHeight } = this.frame;
    this.canvas.width = Math.round(clientWidth * ratio);
    this.canvas.height = Math.round(clientHeight * ratio);
    if (this.slice && (this.isWhole || !this.zoom)) this.whole();
    else this.draw();
  }

  // --- drawing -------------------------------------------------------------------------------------------------

  /** Draw the slice and what lies over it. */
  draw() {
    const pen = this.canvas.getContext("2d");
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
    drawScaleBar(pen, 10, this.canvas.clientHeight - 8, 145, 1 / this.zoom, "#fff", "#000");
  }

  /**
   * The slice as it is seen.
   * @returns {string} as SVG
   */
  svg() {
    this.draw();
    const um = roundLength(145 / this.zoom);
    const bar = { px: um * this.zoom, words: lengthWords(um) };
    const { normal, at_um: at } = this.slice.facts;
    return svgOf(this.canvas, { wide: this.canvas.clientWidth, tall: this.canvas.clientHeight, bar, title: `Slice at ${normal} = ${at.toFixed(2)} µm` });
  }

  // --- mouse and keys ------------------------------------------------------------------------------------------

  /** Let mouse, touch and keys move the view. */
  bind() {
    const { canvas } = this;
    bindGestures(this.frame, {
      pan: (right, down) => {
        this.isWhole = false;
        this.left -= right / this.zoom;
        this.upper -= down / this.zoom;
        this.draw();
      },
      zoom: (factor, [x, y]) => {
        this.zoomBy(factor, x, y);
        this.say();
      },
      click: ([x, y]) => {
        canvas.focus();
        if (this.slice) this.on.onPoint(this.placeOf(x, y));
      },
      hover: (at) => {
        this.cursor = at && { x: at[0], y: at[1] };
        this.say();
      },
      take: (at, shift) => (shift && this.onWindow ? this.window(at) : null),
    });
    canvas.addEventListener("keydown", (event) => this.key(event));
    canvas.addEventListener("focus", () => this.draw());
    canvas.addEventListener("blur", () => this.draw());
  }

  /**
   * A drag with Shift: to the right for a wider range of grey, up for a darker picture.
   * @param {Place} from where the drag began
   * @returns {Held}
   */
  window(from) {
    const [low, high] = this.range;
    const move = (to) => {
      const width = (high - low) * Math.exp((to[0] - from[0]) / 200);
      const level = (low + high) / 2 + ((from[1] - to[1]) / 200) * (high - low);
      this.onWindow?.(level - width / 2, level + width / 2);
    };
    return { move, end: move };
  }

  /**
   * A key of the view.
   * @param {KeyboardEvent} event the key
   */
  key(event) {
    if (!this.slice || event.ctrlKey || event.metaKey || event.altKey) return;
    const { clientWidth, clientHeight } = this.canvas;
    this.cursor ??= { x: clientWidth / 2, y: clientHeight / 2 };
    const step = event.shiftKey ? 5 : 1;
    const moves = { ArrowLeft: [-step, 0], ArrowRight: [step, 0], ArrowUp: [0, -step], ArrowDown: [0, step] };
    const move = moves[event.key];
    if (move) this.moveCursor(move[0], move[1]);
    else if (event.key === "+" || event.key === "=") this.zoomBy(1.25, this.cursor.x, this.cursor.y);
    else if (event.key === "-") this.zoomBy(0.8, this.cursor.x, this.cursor.y);
    else if (event.key === "Home" || event.key === "0") this.whole();
    else if (event.key === "PageDown") this.on.onStep(event.shiftKey ? 10 : 1);
    else if (event.key === "PageUp") this.on.onStep(event.shiftKey ? -10 : -1);
    else if (event.key === "Enter") this.on.onPoint(this.placeOf(this.cursor.x, this.cursor.y));
    else if (event.key === "Backspace") this.on.onBack();
    else return;
    event.preventDefault();
    this.say();
    this.draw();
  }

  /**
   * Move the cursor; at an edge the slice moves under it.
   * @param {number} x screen pixels to the right
   * @param {number} y screen pixels down
   */
  moveCursor(x, y) {
    const cursor = this.cursor;
    const next = { x: cursor.x + x, y: cursor.y + y };
    this.cursor = {
      x: Math.max(0, Math.min(this.canvas.clientWidth, next.x)),
      y: Math.max(0, Math.min(this.canvas.clientHeight, next.y)),
    };
    this.left += (next.x - this.cursor.x) / this.zoom;
    this.upper += (next.y - this.cursor.y) / this.zoom;
  }
}

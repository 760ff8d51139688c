/** A map in um: one plane of the session with its pictures, their colours, and what moves the view. */

import { colourAt, paletteOf, PALETTES } from "./colour.js";
import { Contrast } from "./contrast.js";
import { choice, labelled, make, numbers, positive, shown, withUnit } from "./dom.js";
import { bindGestures } from "./gestures.js";
import { PROJECTION, rawTileLayer } from "./rawtiles.js";
import { lengthWords, roundLength, svgOf, viewBar } from "./viewbar.js";

/**
 * @import {Histogram} from "./contrast.js"
 * @import {Point} from "./geometry.js"
 * @import {Place} from "./gestures.js"
 * @import {App} from "./main.js"
 * @import {Look, Picture} from "./rawtiles.js"
 */

/* global ol */

/** Pixels by which a held arrow key moves the view at most. */
const FASTEST_PX = 32;
/** Screen pixels of a picture's pixel at the closest, and how much smaller than its view a picture gets. */
const [CLOSEST, FARTHEST] = [64, 4];

/**
 * From (x, y) in um, y down, to OpenLayers, y up, and back.
 * @param {number[]} point either of both
 * @returns {number[]} the other one
 */
export const flipped = ([x, y]) => [x, -y];

export class MapView {
  /**
   * Make a view.
   * @param {object} parts what it is for
   * @param {HTMLElement} parts.element element that gets it
   * @param {string} parts.name name of the view
   * @param {App} parts.app session of this window
   * @param {string} [parts.short] stands before the names of its fields of colours
   * @param {(dx: number, dy: number) => boolean} [parts.nudge] moves what is selected by um along the plane's axes, and
   *   tells whether anything is selected
   */
  constructor({ element, name, app, short = name, nudge }) {
    this.name = name;
    this.app = app;
    this.nudge = nudge ?? (() => false);
    this.centreField = make("input", { type: "text", size: 14, spellcheck: "false" });
    this.pixelField = make("input", { type: "number", min: 0, step: "any" });
    this.element = make("div", { class: "map", role: "application", "aria-label": name, tabindex: 0 });
    this.scale = make("div", { class: "scale", "aria-hidden": "true" }, make("span"));
    this.hintLine = make("div", { class: "hint", "aria-hidden": "true", hidden: true });
    const bar = viewBar(name, { zoom: (factor) => this.zoomBy(factor), fit: () => this.whole(), svg: () => this.svg() });
    this.element.append(this.scale, this.hintLine, bar, make("div", { class: "cross", "aria-hidden": "true" }));
    this.fields = make(
      "div",
      { class: "fields" },
      labelled("centre, um", this.centreField, `${name} `),
      labelled("um per screen pixel", this.pixelField, `${name}, `, "µm/pixel"),
    );
    this.palette = choice(Object.keys(PALETTES), () => this.recolour());
    this.palette.setAttribute("aria-label", `${short} colours`);
    const say = (text) => app.say(text);
    this.contrast = new Contrast({ name: `${short} colour range`, onChange: () => this.recolour(), say, before: this.palette });
    element.append(this.element, this.contrast.element, this.fields);
    this.picture = null;
    this.layer = null;
    this.more = {};
    this.onLook = () => {};
    /** Places are (x, y) in um, and in screen pixels. */
    this.clicks = [];
    this.hovers = [];
    /** What may take a drag, the first that wants it. */
    this.takes = [];
    /** What else is to be seen in the view as a whole, corners in um. */
    this.beside = () => [];
    this.view = new ol.View({
      projection: PROJECTION,
      center: [0, 0],
      resolution: 1,
      minResolution: 1e-4,
      maxResolution: 1e6,
      constrainRotation: false,
    });
    this.map = new ol.Map({ target: this.element, view: this.view, controls: [], interactions: [] });
    for (const [event, busy] of [["loadstart", "true"], ["loadend", "false"]]) {
      this.map.on(event, () => this.element.setAttribute("aria-busy", busy));
    }
    this.map.on("change:size", () => this.fitted === this.state && this.fit());
    this.bindFields();
    this.bindKeys();
    bindGestures(this.element, {
      pan: (right, down) => this.shift(...this.onPlane(-right * this.pixel, -down * this.pixel)),
      zoom: (factor, at) => this.zoomBy(factor, at),
      click: (at) => this.clicks.forEach((act) => act(this.pointAt(at), at)),
      hover: (at) => this.hovers.forEach((act) => act(at && this.pointAt(at))),
      take: (at, shift) => {
        for (const take of this.takes) {
          const held = take(at, shift);
          if (held) return held;
        }
        return null;
      },
    });
    this.view.on(["change:center", "change:resolution", "change:rotation"], () => this.showPlace());
    this.showPlace();
  }

  // --- where the view is -----------------------------------------------------------------------------------------

  /**
   * Middle of the view, (x, y) in um.
   * @returns {Point}
   */
  get centre() {
    return flipped(this.view.getCenter());
  }

  /**
   * Put a point exactly into the middle.
   * @param {Point} point (x, y) in um
   */
  set centre(point) {
    this.view.cancelAnimations();
    this.view.setCenter(flipped(point));
  }

  /**
   * um per screen pixel.
   * @returns {number}
   */
  get pixel() {
    return this.view.getResolution();
  }

  /**
   * Show the map at another scale, as far as the limits allow.
   * @param {number} um per screen pixel
   */
  set pixel(um) {
    const [finest, coarsest] = this.limits;
    this.view.setResolution(Math.max(finest, Math.min(coarsest, um)));
  }

  /**
   * Width and height on the screen.
   * @returns {number[]} in screen pixels
   */
  get size() {
    return this.map.getSize() ?? [400, 300];
  }

  /**
   * The finest and the coarsest um per screen pixel.
   * @returns {[number, number]}
   */
  get limits() {
    if (!this.picture) return [0, Infinity];
    const { shape, pixel_um: pixel } = this.picture;
    const whole = Math.max((shape[1] * pixel[1]) / this.size[0], (shape[0] * pixel[0]) / this.size[1]);
    return [Math.min(...pixel) / CLOSEST, whole * FARTHEST];
  }

  /**
   * Where the view is, as a text to compare.
   * @returns {string}
   */
  get state() {
    return [this.view.getCenter(), this.pixel, this.view.getRotation()].join();
  }

  /** Show the whole picture, and what is beside it; it stays whole while the window changes. */
  fit() {
    if (!this.picture || this.size[0] < 50) return;
    const [left, bottom, right, top] = this.extent(this.picture);
    const corners = [[left, bottom], [left, top], [right, bottom], [right, top], ...this.beside().map(flipped)];
    const geometry = new ol.geom.Polygon([[...corners, corners[0]]]);
    this.view.fit(geometry, { size: this.size, padding: [12, 12, 12, 12] });
    this.fitted = this.state;
  }

  /** Show the whole picture upright. */
  whole() {
    this.view.setRotation(0);
    this.fit();
  }

  /**
   * Zoom about a place.
   * @param {number} factor above 1 comes closer
   * @param {Place} [at] place on the screen that stays; the middle where it is not given
   */
  zoomBy(factor, at) {
    const before = at && this.pointAt(at);
    this.pixel /= factor;
    if (!at) return;
    const after = this.pointAt(at);
    this.shift(before[0] - after[0], before[1] - after[1]);
  }

  /**
   * Move the view.
   * @param {number} dx um along the plane's x
   * @param {number} dy um along the plane's y
   */
  shift(dx, dy) {
    const [x, y] = this.centre;
    this.centre = [x + dx, y + dy];
  }

  /**
   * The rectangle of a picture, with OpenLayers' y up.
   * @param {object} picture where it lies
   * @param {number[]} picture.shape rows and columns
   * @param {number[]} picture.pixel_um pitch of rows and of columns
   * @param {number[]} picture.origin_um x and y of the first pixel's middle
   * @returns {[number, number, number, number]} left, bottom, right, top
   */
  extent({ shape: [rows, cols], pixel_um: [dy, dx], origin_um: [x0, y0] }) {
    return [x0 - dx / 2, -(y0 + (rows - 0.5) * dy), x0 + (cols - 0.5) * dx, -(y0 - dy / 2)];
  }

  /**
   * Corners of the picture, (x, y) in um.
   * @returns {Point[]}
   */
  get corners() {
    if (!this.picture) return [];
    const [left, bottom, right, top] = this.extent(this.picture);
    return [[left, -top], [right, -top], [right, -bottom], [left, -bottom]];
  }

  /**
   * The place in um of a place on the screen.
   * @param {Place} at on the screen
   * @returns {Point}
   */
  pointAt([right, down]) {
    const { width, height } = this.element.getBoundingClientRect(); // OpenLayers counts whole pixels
    const [wide, tall] = this.size.map((n) => n * this.pixel);
    const [dx, dy] = this.onPlane((right / width - 0.5) * wide, (down / height - 0.5) * tall);
    return [this.centre[0] + dx, this.centre[1] + dy];
  }

  /**
   * Tell whether a point lies within what is seen.
   * @param {Point} point (x, y) in um
   * @returns {boolean}
   */
  sees(point) {
    const at = this.map.getPixelFromCoordinate(flipped(point));
    return at !== null && at.every((px, k) => px >= 0 && px <= this.size[k]);
  }

  // --- what is shown ---------------------------------------------------------------------------------------------

  /**
   * Show a picture; the first one is shown whole, later ones where the view is.
   * @param {Picture} picture one of `app.pictures`
   */
  show(picture) {
    const first = this.picture === null;
    if (this.layer) this.map.removeLayer(this.layer);
    this.picture = picture;
    this.palette.value = paletteOf(picture);
    this.showColours();
    this.layer = rawTileLayer(picture, this.app.api, { ...this.look, ...this.more });
    this.map.getLayers().insertAt(0, this.layer);
    void this.count(picture);
    if (!first) return;
    this.map.updateSize();
    this.fit();
  }

  /**
   * Take the limits of the colours from the values that are valid.
   * @param {Picture} picture the one that is shown
   * @returns {Promise<void>}
   */
  async count(picture) {
    const counted = await this.app.histogram(picture).catch(() => null); // the view stays in the colours that it has
    if (!counted || this.picture !== picture) return;
    this.showColours(counted);
    this.recolour();
  }

  /**
   * Show the colour bar of the picture.
   * @param {Histogram|null} [counted] how its values are distributed, once that is known
   */
  showColours(counted = null) {
    const shade = (share) => colourAt(this.palette.value, share);
    const { range } = this.picture;
    const aroundZero = paletteOf(this.picture) === "RdBu_r";
    this.contrast.show({ ...this.picture, shade, counted: counted && aroundZero ? { ...counted, range } : counted });
  }

  /**
   * Colours and their limits.
   * @returns {Look}
   */
  get look() {
    const [low, high] = this.contrast.limits;
    return { palette: this.palette.value, low, high };
  }

  /**
   * Draw the picture in other colours, or with other masks and brushes.
   * @param {Look} [more] masks and brushes
   */
  recolour(more = this.more) {
    this.more = more;
    this.contrast.write();
    this.layer?.getSource().look({ ...this.look, ...more });
    this.onLook();
  }

  /**
   * Say over the map what is to be done in it.
   * @param {string} text empty for nothing
   */
  hint(text) {
    this.hintLine.textContent = text;
    this.hintLine.hidden = !text;
  }

  /** Write where the view is into the fields, and draw the scale bar. */
  showPlace() {
    const focused = document.activeElement;
    if (this.centreField !== focused) this.centreField.value = this.centre.map((um) => um.toFixed(2)).join(", ");
    if (this.pixelField !== focused) this.pixelField.value = String(Number(this.pixel.toPrecision(4)));
    const length = roundLength(145 * this.pixel);
    this.bar = { px: length / this.pixel, words: lengthWords(length) };
    this.scale.style.width = `${this.bar.px}px`;
    this.scale.firstChild.textContent = this.bar.words;
  }

  /**
   * What is seen, with its bars.
   * @returns {string} as SVG
   */
  svg() {
    this.map.renderSync();
    const [wide, tall] = this.size;
    const whole = make("canvas", { width: wide, height: tall });
    const pen = whole.getContext("2d");
    pen.fillStyle = getComputedStyle(this.element).backgroundColor;
    pen.fillRect(0, 0, wide, tall);
    for (const canvas of this.element.querySelectorAll("canvas")) drawIn(pen, canvas, this.element);
    const shade = (share) => colourAt(this.palette.value, share);
    const words = this.contrast.limits.map((value, k) => shown(value) + (k ? withUnit(this.picture) : ""));
    const { bar } = this;
    return svgOf(whole, { wide, tall, bar, title: `${this.name}: ${this.picture.title}`, colours: { shade, limits: this.contrast.limits, words } });
  }

  // --- fields and keys -------------------------------------------------------------------------------------------

  /** Let the fields move the view. */
  bindFields() {
    const place = (text) => numbers(text, 2);
    this.onField(this.centreField, place, (point) => (this.centre = point), `${this.name} centre is "x, y" in um.`);
    const needed = `${this.name}: um per screen pixel is a number above 0.`;
    this.onField(this.pixelField, positive, ([um]) => (this.pixel = um), needed);
  }

  /**
   * Use what is written into a field, or say what is needed there.
   * @param {HTMLInputElement} field the field
   * @param {(text: string) => number[]|null} read gives null for what cannot be used
   * @param {(values: number[]) => void} use gets what was read
   * @param {string} needed what the field takes, in words
   */
  onField(field, read, use, needed) {
    const take = () => {
      const values = read(field.value);
      field.setAttribute("aria-invalid", String(!values));
      if (values) {
        use(values);
        this.map.renderSync(); // a click that follows at once means what is seen now
      } else this.app.say(needed);
    };
    field.addEventListener("change", take);
    field.addEventListener("keydown", (event) => event.key === "Enter" && take());
    field.addEventListener("blur", () => this.showPlace());
  }

  /** Let keys move the view. */
  bindKeys() {
    const steps = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
    let pace = 1;
    this.element.addEventListener("keydown", (event) => {
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      const step = steps[event.key];
      if (step) {
        event.preventDefault();
        pace = event.repeat ? Math.min(FASTEST_PX, pace * 1.3) : 1;
        this.arrow(step[0], step[1], event.shiftKey ? 5 : 1, pace);
      } else if (event.key === "+" || event.key === "=") this.zoomBy(Math.SQRT2);
      else if (event.key === "-") this.zoomBy(Math.SQRT1_2);
      else if (event.key === "[" || event.key === "]") {
        this.view.setRotation(this.view.getRotation() + (event.key === "[" ? -1 : 1) * (Math.PI / 36));
      } else if (event.key === "0") this.whole();
    });
  }

  /**
   * Move what is selected, or else the view, along the screen; a held key moves the view faster and faster.
   * @param {number} right -1, 0 or 1
   * @param {number} down -1, 0 or 1
   * @param {number} pixels screen pixels of a step
   * @param {number} pace how much faster the view moves
   */
  arrow(right, down, pixels, pace) {
    const [dx, dy] = this.onPlane(right * pixels * this.pixel, down * pixels * this.pixel);
    if (!this.nudge(dx, dy)) this.shift(dx * pace, dy * pace);
  }

  /**
   * Turn a vector on the screen, (right, down), to the plane's axes.
   * @param {number} right any length
   * @param {number} down in the same unit
   * @returns {[number, number]} in that unit
   */
  onPlane(right, down) {
    const turn = this.view.getRotation();
    const [cos, sin] = [Math.cos(turn), Math.sin(turn)];
    return [right * cos + down * sin, -right * sin + down * cos];
  }
}

/**
 * Draw a canvas of a view where it is seen: moved, turned, cut and pale as the elements around it are.
 * @param {CanvasRenderingContext2D} pen canvas that gets it
 * @param {HTMLCanvasElement} canvas a layer of the view
 * @param {HTMLElement} view the view
 */
function drawIn(pen, canvas, view) {
  let [place, opacity, right] = [new DOMMatrix(), 1, view.clientWidth];
  for (let one = /** @type {HTMLElement} */ (canvas); one !== view; one = one.parentElement) {
    const style = getComputedStyle(one);
    if (style.visibility === "hidden") return;
    const [x, y] = style.transformOrigin.split(" ").map(parseFloat);
    place = new DOMMatrix().translate(x, y).multiply(new DOMMatrix(style.transform)).translate(-x, -y).multiply(place);
    opacity *= Number(style.opacity);
    const cut = /inset\(0(?:px)? ([\d.]+)%/.exec(style.clipPath);
    if (cut) right *= 1 - Number(cut[1]) / 100;
  }
  pen.save();
  pen.beginPath();
  pen.rect(0, 0, right, view.clientHeight);
  pen.clip();
  pen.globalAlpha = opacity;
  pen.setTransform(place);
  if (canvas.width && canvas.height) pen.drawImage(canvas, 0, 0);
  pen.restore();
}

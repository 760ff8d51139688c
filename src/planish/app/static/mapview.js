/** A map in um: one plane of the session with its pictures, moved by mouse, keys and fields. */

import { labelled, make, numbers, positive } from "./dom.js";
import { rawTileLayer } from "./rawtiles.js";

/* global ol */

/** Pixels by which a held arrow key moves the view at most. */
const FASTEST_PX = 32;
/** A press that moves less is a click. */
const CLICK_PX = 4;

const UM = new ol.proj.Projection({ code: "um", units: "m", metersPerUnit: 1e-6, getPointResolution: (r) => r });

/** From (x, y) in um, y down, to OpenLayers, y up, and back. @param {number[]} point @returns {[number, number]} */
export const flipped = ([x, y]) => [x, -y];

export class MapView {
  /**
   * @param {{element: HTMLElement, name: string, app: any, pixelField?: HTMLInputElement,
   *   centreField?: HTMLInputElement, nudge?: (dx: number, dy: number) => boolean}} options
   *   `nudge(dx, dy)` moves what is selected by um along the plane's axes and tells whether anything is selected
   */
  constructor({ element, name, app, pixelField, centreField, nudge }) {
    this.name = name;
    this.app = app;
    this.nudge = nudge ?? (() => false);
    this.centreField = centreField ?? make("input", { type: "text", size: 16, spellcheck: "false" });
    this.pixelField = pixelField ?? make("input", { type: "number", min: 0, step: "any" });
    this.element = make("div", { class: "map", role: "application", "aria-label": name, tabindex: 0 });
    this.scale = make("div", { class: "scale", "aria-hidden": "true" }, make("span"));
    this.hintLine = make("div", { class: "hint", "aria-hidden": "true", hidden: true });
    this.element.append(this.scale, this.hintLine, make("div", { class: "cross", "aria-hidden": "true" }));
    this.fields = make(
      "div",
      { class: "fields" },
      ...(centreField ? [] : [labelled("centre, um", this.centreField, `${name} `)]),
      ...(pixelField ? [] : [labelled("um per screen pixel", this.pixelField, `${name}, `)]),
    );
    element.append(this.element, this.fields);
    this.picture = null;
    this.layer = null;
    this.view = new ol.View({
      projection: UM,
      center: [0, 0],
      resolution: 1,
      minResolution: 1e-3,
      maxResolution: 1e5,
      constrainRotation: false,
      smoothResolutionConstraint: false,
      smoothExtentConstraint: false,
    });
    this.map = new ol.Map({
      target: this.element,
      view: this.view,
      controls: [],
      moveTolerance: CLICK_PX,
      interactions: ol.interaction.defaults.defaults({ doubleClickZoom: false, keyboard: false, pinchRotate: true }),
    });
    for (const [event, busy] of [["loadstart", "true"], ["loadend", "false"]]) {
      this.map.on(event, () => this.element.setAttribute("aria-busy", busy));
    }
    this.bindFields();
    this.bindKeys();
    this.view.on(["change:center", "change:resolution", "change:rotation"], () => this.showPlace());
    this.showPlace();
  }

  // --- where the view is -----------------------------------------------------------------------------------------

  /** Middle of the view, (x, y) in um. @returns {[number, number]} */
  get centre() {
    return flipped(this.view.getCenter());
  }

  /** Put a point, (x, y) in um, exactly into the middle. @param {number[]} point */
  set centre(point) {
    this.view.cancelAnimations();
    this.view.setCenter(flipped(point));
  }

  /** um per screen pixel. @returns {number} */
  get pixel() {
    return this.view.getResolution();
  }

  set pixel(um) {
    this.view.setResolution(um);
  }

  /** Show the whole picture. */
  fit() {
    if (!this.picture) return;
    const size = this.map.getSize() ?? [400, 300];
    this.view.fit(this.extent(this.picture), { size, padding: [12, 12, 12, 12] });
  }

  /** @param {any} picture @returns {number[]} extent for OpenLayers */
  extent({ shape: [rows, cols], pixel_um: [dy, dx], origin_um: [x0, y0] }) {
    return [x0 - dx / 2, -(y0 + (rows - 0.5) * dy), x0 + (cols - 0.5) * dx, -(y0 - dy / 2)];
  }

  /** Whether a point lies within what is seen. @param {number[]} point (x, y) in um */
  sees(point) {
    const at = this.map.getPixelFromCoordinate(flipped(point));
    const [width, height] = this.map.getSize() ?? [0, 0];
    return at !== null && at[0] >= 0 && at[1] >= 0 && at[0] <= width && at[1] <= height;
  }

  // --- what is shown ---------------------------------------------------------------------------------------------

  /**
   * Show a picture; the first one is shown whole, later ones where the view is.
   * @param {any} picture one of `app.pictures`
   */
  show(picture) {
    const first = this.picture === null;
    if (this.layer) this.map.removeLayer(this.layer);
    this.picture = picture;
    this.layer = rawTileLayer(picture, this.app.api);
    this.map.getLayers().insertAt(0, this.layer);
    if (first) {
      this.map.updateSize();
      this.fit();
    }
  }

  /** Say over the map what is to be done in it. @param {string} text */
  hint(text) {
    this.hintLine.textContent = text;
    this.hintLine.hidden = !text;
  }

  /** Write where the view is into the fields, and draw the scale bar. */
  showPlace() {
    const focused = document.activeElement;
    if (this.centreField !== focused) this.centreField.value = this.centre.map((um) => um.toFixed(2)).join(", ");
    if (this.pixelField !== focused) this.pixelField.value = String(Number(this.pixel.toPrecision(5)));
    const longest = 145 * this.pixel;
    const power = 10 ** Math.floor(Math.log10(longest));
    const length = power * ([5, 2].find((step) => step * power <= longest) ?? 1);
    this.scale.style.width = `${length / this.pixel}px`;
    this.scale.firstChild.textContent = length >= 1000 ? `${length / 1000} mm` : `${Number(length.toPrecision(2))} um`;
  }

  // --- fields and keys -------------------------------------------------------------------------------------------

  bindFields() {
    const place = (/** @type {string} */ text) => numbers(text, 2);
    this.onField(this.centreField, place, (point) => (this.centre = point), `${this.name} centre is "x, y" in um.`);
    const needed = `${this.name}: um per screen pixel is a number above 0.`;
    this.onField(this.pixelField, positive, ([um]) => (this.pixel = um), needed);
  }

  /**
   * @param {HTMLInputElement} field
   * @param {(text: string) => number[]|null} read
   * @param {(values: number[]) => void} use
   * @param {string} needed
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

  bindKeys() {
    const steps = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, -1], ArrowDown: [0, 1] };
    let pace = 1;
    this.element.addEventListener("keydown", (/** @type {KeyboardEvent} */ event) => {
      if (event.ctrlKey || event.metaKey || event.altKey) return;
      const step = steps[/** @type {keyof typeof steps} */ (event.key)];
      if (step) {
        event.preventDefault();
        pace = event.repeat ? Math.min(FASTEST_PX, pace * 1.3) : 1;
        this.arrow(step[0], step[1], event.shiftKey ? 5 : 1, pace);
      } else if (event.key === "+" || event.key === "=") this.view.setResolution(this.pixel / Math.SQRT2);
      else if (event.key === "-") this.view.setResolution(this.pixel * Math.SQRT2);
      else if (event.key === "[" || event.key === "]") {
        this.view.setRotation(this.view.getRotation() + (event.key === "[" ? -1 : 1) * (Math.PI / 36));
      } else if (event.key === "0") {
        this.view.setRotation(0);
        this.fit();
      }
    });
  }

  /**
   * Move what is selected, or else the view, along the screen; a held key moves the view faster and faster.
   * @param {number} right
   * @param {number} down
   * @param {number} pixels
   * @param {number} pace
   */
  arrow(right, down, pixels, pace) {
    const [dx, dy] = this.onPlane(right * pixels * this.pixel, down * pixels * this.pixel);
    if (this.nudge(dx, dy)) return;
    const [x, y] = this.centre;
    this.centre = [x + dx * pace, y + dy * pace];
  }

  /** Turn a vector on the screen, (right, down), to the plane's axes. @param {number} right @param {number} down */
  onPlane(right, down) {
    const turn = this.view.getRotation();
    const [cos, sin] = [Math.cos(turn), Math.sin(turn)];
    return [right * cos + down * sin, -right * sin + down * cos];
  }
}

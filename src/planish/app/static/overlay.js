/** The moving picture laid over the fixed one: blend, swipe, blink and checkerboard. */

import { affine, after, angleOf, inverse, mapped, scaleOf, turned } from "./geometry.js";
import { labelled, make } from "./dom.js";
import { rawTileLayer } from "./rawtiles.js";
import { pairsOf, similarityOf } from "./linked.js";
import { flipped } from "./mapview.js";

/**
 * @import {MapView} from "./mapview.js"
 * @import {Picture} from "./rawtiles.js"
 * @import {Mark, State} from "./store.js"
 */

/* global ol */

const BLINK_MS = 600;
export const WAYS = [
  ["two", "side by side"],
  ["blend", "blend"],
  ["swipe", "swipe"],
  ["blink", "flicker"],
  ["checkerboard", "checkerboard"],
];

export class Overlay {
  /**
   * Make the upper map, and the control of its share.
   * @param {MapView} base view of the fixed plane
   * @param {MapView} upper view of the moving one, whose colours it has
   */
  constructor(base, upper) {
    this.base = base;
    this.upper = upper;
    upper.onLook = () => this.layer?.getSource().look(upper.look);
    this.way = "two";
    /** From the moving to the fixed plane */
    this.fit = null;
    this.model = "similarity";
    this.inner = make("div", { class: "over-inner" });
    this.outer = make("div", { class: "over", "aria-hidden": "true" }, this.inner);
    this.share = make("input", { type: "range", min: 0, max: 100, value: 50, oninput: () => this.paint() });
    this.control = labelled(`Share of the ${upper.name}, %`, this.share);
    this.control.hidden = true;
    this.view = new ol.View({
      projection: base.view.getProjection(),
      center: [0, 0],
      resolution: 1,
      minResolution: 1e-4,
      maxResolution: 1e6,
      constrainRotation: false,
    });
    this.map = new ol.Map({ target: this.inner, view: this.view, controls: [], interactions: [] });
    // Between the picture and the marks of the lower map, which calls `render` for each frame that it draws.
    this.place = new ol.layer.Layer({ zIndex: 1, visible: false, render: () => this.placed() });
    base.map.addLayer(this.place);
    this.timer = 0;
  }

  /**
   * Lay a picture of the moving plane over the other.
   * @param {Picture} picture of the moving plane
   */
  show(picture) {
    this.layer = rawTileLayer(picture, this.base.app.api, this.upper.look);
    this.map.setLayers([this.layer]);
  }

  /** Stop the timer, and give the map back. */
  close() {
    clearInterval(this.timer);
    this.map.setTarget(null);
  }

  /**
   * Lay the pictures over each other while a mark is dragged: by an affine map, until the model has followed.
   * @param {Mark[]} marks those of the session, with the dragged one where it is
   */
  follow(marks) {
    if (this.way === "two" || !this.fit) return;
    const pairs = pairsOf(({ marks }));
    const [from, to] = [pairs.map((mark) => mark.moving), pairs.map((mark) => mark.fixed)];
    this.fit = affine(from, to) ?? this.fit;
    this.base.map.render();
  }

  /**
   * Take the fit of the marks: affine where that is the model, its similarity part otherwise.
   * @param {State} state that of the session
   */
  update(state) {
    this.model = state.fit?.model === "affine" ? "affine" : "similarity";
    this.fit = similarityOf(state);
    if (this.fit && this.model === "affine") {
      const pairs = pairsOf(state);
      const [from, to] = [pairs.map((mark) => mark.moving), pairs.map((mark) => mark.fixed)];
      this.fit = affine(from, to);
    }
    this.setWay(this.way);
  }

  /**
   * Lay the pictures over each other in another way.
   * @param {string} way one of `WAYS`
   */
  setWay(way) {
    const other = way !== this.way;
    this.way = way;
    const on = way !== "two" && this.fit !== null;
    this.place.setVisible(on);
    this.control.hidden = !on || (way !== "blend" && way !== "swipe");
    this.control.firstChild.lastChild.textContent = way === "swipe" ? "Swipe, % from the left" : `Share of the ${this.upper.name}, %`;
    if (!on || other) {
      clearInterval(this.timer);
      this.timer = 0;
      this.inner.classList.remove("off");
    }
    if (on && way === "blink" && !this.timer) {
      this.timer = window.setInterval(() => this.inner.classList.toggle("off"), BLINK_MS);
    }
    this.paint();
    this.base.map.render();
  }

  /**
   * What is to be said of the overlay.
   * @returns {string}
   */
  get words() {
    if (this.way === "two") return "";
    if (!this.fit) return "The pictures can be laid over each other from three pairs on.";
    const part = this.model === "affine" ? "affine map" : "similarity part";
    return `${this.upper.name} laid over the ${this.base.name} by the ${part} of the marks.`;
  }

  /** Show as much of the upper map as its way and share say. */
  paint() {
    const share = Number(this.share.value);
    this.inner.style.opacity = this.way === "blend" ? String(share / 100) : "1";
    this.outer.style.clipPath = this.way === "swipe" ? `inset(0 ${100 - share}% 0 0)` : "";
    this.outer.classList.toggle("checked", this.way === "checkerboard");
  }

  /**
   * Move the upper map to where the lower one is. What a view cannot do, stretch and mirror, is left to a CSS matrix:
   * base = turn(r) fit turn(-r') / scale, where turn(r) takes the axes of a plane to those of a screen turned by r.
   * @returns {HTMLElement} element that OpenLayers puts into the lower map
   */
  placed() {
    const fit = this.fit;
    const scale = scaleOf(fit);
    const turn = this.base.view.getRotation();
    const own = turn + angleOf(fit);
    this.view.setCenter(flipped(mapped(inverse(fit), this.base.centre)));
    this.view.setResolution(this.base.pixel / scale);
    this.view.setRotation(own);
    const linear = { a: fit.a / scale, b: fit.b / scale, c: fit.c / scale, d: fit.d / scale, e: 0, f: 0 };
    const { a, b, c, d } = after(turned(turn), after(linear, turned(-own)));
    this.inner.style.transform = `matrix(${a}, ${c}, ${b}, ${d}, 0, 0)`;
    return this.outer;
  }
}

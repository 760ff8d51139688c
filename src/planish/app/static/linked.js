/** Two views that show the same place of the sheet: where one goes, the other follows. */

import { angleOf, inverse, isMirrored, mapped, ofSimilarity, scaleOf } from "./geometry.js";

/**
 * @import {Affine} from "./geometry.js"
 * @import {MapView} from "./mapview.js"
 * @import {Mark, Side, State} from "./store.js"
 */

/** Pairs from which on the views move together. */
export const LINKED_FROM = 3;

/**
 * From the moving to the fixed plane by the closest similarity to the fit, once enough pairs are in use.
 * @param {State} state that of the session
 * @returns {Affine|null}
 */
export const similarityOf = (state) =>
  pairsOf(state).length >= LINKED_FROM && state.fit?.transform ? ofSimilarity(state.fit.transform) : null;

/**
 * Marks in use with both ends.
 * @param {{marks: Mark[]}} state that of the session
 * @returns {Mark[]}
 */
export const pairsOf = ({ marks }) => marks.filter((mark) => mark.used && mark.moving && mark.fixed);

export class Linked {
  /**
   * Let two views move each other.
   * @param {MapView} moving view of the moving plane
   * @param {MapView} fixed view of the fixed plane
   */
  constructor(moving, fixed) {
    this.views = { moving, fixed };
    /** From the moving to the fixed plane */
    this.map = null;
    this.on = true;
    this.busy = false;
    moving.beside = () => (this.moves ? fixed.corners.map((one) => mapped(inverse(this.map), one)) : []);
    fixed.beside = () => (this.moves ? moving.corners.map((one) => mapped(this.map, one)) : []);
    /** @type {Side} the view that was moved last leads */
    this.leads = "moving";
    for (const side of /** @type {Side[]} */ (["moving", "fixed"])) {
      this.views[side].view.on(["change:center", "change:resolution", "change:rotation"], () => this.follow(side));
    }
  }

  /**
   * Whether one view moves the other.
   * @returns {boolean}
   */
  get moves() {
    return this.on && this.map !== null;
  }

  /**
   * Take a new fit; the view that does not lead moves where it differs.
   * @param {Affine|null} map from the moving to the fixed plane; null where there is no fit
   */
  update(map) {
    const first = !this.map && map;
    this.map = map;
    if (!map) return;
    const leading = this.views[this.leads];
    if (first && leading.fitted === leading.state) leading.fit();
    this.follow(this.leads);
  }

  /**
   * Bring the other view to where this one is.
   * @param {Side} side the view that was moved
   */
  follow(side) {
    if (this.busy || !this.moves) {
      if (!this.busy) this.leads = side;
      return;
    }
    this.leads = side;
    const other = side === "moving" ? "fixed" : "moving";
    const forward = this.map;
    const map = side === "moving" ? forward : inverse(forward);
    const [from, to] = [this.views[side].view, this.views[other]];
    this.busy = true;
    to.centre = mapped(map, this.views[side].centre);
    to.pixel = this.views[side].pixel * scaleOf(map);
    if (!isMirrored(map)) to.view.setRotation(from.getRotation() - angleOf(map));
    this.busy = false;
  }
}

/** What lies under the pointer, and where that is in the other view, as the marks say so far. */

import { written } from "./dom.js";

/**
 * @import {Found} from "./atcursor.js"
 * @import {Point} from "./geometry.js"
 * @import {App} from "./main.js"
 * @import {MarkLayer} from "./marklayer.js"
 * @import {Picture} from "./rawtiles.js"
 * @import {Mark, Side} from "./store.js"
 */

/** The pointer rests so long before the server is asked: a click is answered first. */
const REST_MS = 40;

export class Prediction {
  /**
   * Begin with the pointer outside of both views.
   * @param {App} app session of this window
   * @param {Record<Side, MarkLayer>} layers those of both views
   * @param {Record<Side, string>} names those of both views
   */
  constructor(app, layers, names) {
    this.app = app;
    this.names = names;
    this.layers = layers;
    this.wanted = null;
    this.busy = false;
    this.inside = false;
    this.mark = null;
  }

  /**
   * Show the predicted end of a mark that has one end only.
   * @param {Mark|null} mark null shows none
   */
  showFor(mark) {
    this.mark = mark;
    this.rest();
  }

  /** Show the predicted end of that mark while the pointer is elsewhere. */
  rest() {
    for (const side of ["moving", "fixed"]) {
      const place = this.mark && !this.mark[side] ? this.mark.predicted?.[side] : null;
      this.layers[side].showGhost(place ?? null);
      if (place) this.app.predicted(`${this.mark?.label} in the ${this.names[side]}: ${written(place)} um`);
    }
  }

  /**
   * Follow the pointer; one question is asked at a time.
   * @param {Side} side the view
   * @param {Point|null} point (x, y) in um; null where it has left the view
   */
  point(side, point) {
    this.wanted = point && { side, point };
    this.inside = point !== null;
    if (!point) {
      this.app.predicted("");
      this.rest();
    } else if (!this.busy) void this.ask();
  }

  /**
   * Ask the server until the pointer rests.
   * @returns {Promise<void>}
   */
  async ask() {
    this.busy = true;
    while (this.wanted) {
      const { wanted } = this;
      await new Promise((done) => setTimeout(done, REST_MS));
      await this.app.queue;
      if (wanted !== this.wanted) continue;
      const { side, point } = wanted;
      this.wanted = null;
      const there = side === "moving" ? "fixed" : "moving";
      const query = new URLSearchParams({ x: String(point[0]), y: String(point[1]) });
      const { picture } = this.layers[side].view;
      const [found, here] = await Promise.all([
        this.app.api.get(this.app.ofLayer(`predict?side=${side}&${query}`)).catch(() => null),
        picture && this.app.api.get(`cursor?id=${picture.id}&${query}`).catch(() => null),
      ]);
      if (!this.inside) break;
      this.layers[there].showGhost(found ? [found.x, found.y] : null);
      this.app.predicted(found ? `${this.names[there]} x, y: ${written([found.x, found.y])} um; ${found.text}` : "No pair yet");
      this.app.cursor([`${this.names[side]} x, y: ${written(point)} um`, ...valuesAt(here, picture)].join("; "));
    }
    this.busy = false;
  }
}

/**
 * The value of the shown picture, and where the point lies in the volume.
 * @param {Found|null} here what lies at the pointer
 * @param {Picture} picture the one that is shown
 * @returns {string[]}
 */
function valuesAt(here, picture) {
  if (!here) return [];
  const own = here.values.find((one) => one.id === picture.id);
  const units = own?.units === "1" ? "" : (own?.units ?? "");
  const text = () => `${picture.title} ${Number(own.value.toPrecision(4))} ${units}`.trim();
  const { volume } = here;
  return [...(typeof own?.value === "number" ? [text()] : []), ...(volume ? [`volume x, y, z: ${written([volume.x, volume.y, volume.z])} um`] : [])];
}

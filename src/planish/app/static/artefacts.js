/** Regions of the reference that a person declares as artefacts, with author and reason. */

import { button, labelled, make } from "./dom.js";

/**
 * @import {Point} from "./geometry.js"
 * @import {App} from "./main.js"
 * @import {Region} from "./store.js"
 */

/**
 * Read "x, y; x, y; …" as corners; null where it is none of three corners or more.
 * @param {string} text as a person wrote it
 * @returns {Point[]|null} (x, y) in um
 */
export function cornersOf(text) {
  const corners = text
    .trim()
    .split(/[;\n]+/)
    .filter((part) => part.trim())
    .map((part) => part.trim().split(/[\s,]+/).map(Number));
  return corners.length >= 3 && corners.every((one) => one.length === 2 && one.every(Number.isFinite)) ? corners : null;
}

const FIELDS = { Name: "Its name", Author: "Your name", Reason: "Reason" };

export class Artefacts {
  /**
   * Make the panel of the artefacts.
   * @param {App} app session of this window
   * @param {object} maps where they are drawn
   * @param {() => void} maps.draw lets a person draw a polygon, which comes back by `drawn`
   * @param {(polygons: Point[][]) => void} maps.show draws those that there are
   */
  constructor(app, maps) {
    this.app = app;
    this.maps = maps;
    this.shown = "";
    this.declared = [];
    this.name = make("input", { type: "text", size: 14, maxlength: 60 });
    this.author = make("input", { type: "text", size: 14, maxlength: 100 });
    this.reason = make("input", { type: "text", size: 26, maxlength: 300 });
    this.polygon = make("textarea", { rows: 4, cols: 18, spellcheck: "false" });
    this.list = make("ul", { class: "artefacts", "aria-label": "Declared artefacts" });
    this.element = make(
      "section",
      { class: "panel", "aria-label": "Artefacts" },
      make("h2", {}, "Artefacts"),
      make("p", { class: "soft" }, "A stain or fold to leave out: draw it, declare it, then Apply."),
      this.list, // grows upwards: Declare stays where it is
      make("div", { class: "group" }, ...Object.entries(FIELDS).map(([name, seen]) => labelled(name, this[name.toLowerCase()], "Artefact: ", seen))),
      make("div", { class: "group" }, button("Draw polygon", () => maps.draw()), labelled("Polygon, um", this.polygon)),
      button("Declare artefact", () => void this.declare()),
    );
    app.onState((state) => this.show(state.regions ?? []));
  }

  /**
   * A polygon that was drawn.
   * @param {Point[]} corners (x, y) in um
   */
  drawn(corners) {
    this.polygon.value = corners.map((point) => point.map((um) => um.toFixed(1)).join(", ")).join("; ");
    this.polygon.removeAttribute("aria-invalid");
    this.maps.show([...this.declared, corners]);
    this.name.focus();
  }

  /**
   * Save the polygon of the field as an artefact.
   * @returns {Promise<void>}
   */
  async declare() {
    const polygon = cornersOf(this.polygon.value);
    this.polygon.setAttribute("aria-invalid", String(!polygon));
    if (!polygon) return this.app.say('A polygon is "x, y; x, y; x, y": three corners or more, in um.');
    const [name, author, reason] = [this.name, this.author, this.reason].map((field) => field.value.trim());
    if (!(author && reason)) return this.app.say("Give it an author and a reason: they stand in the report.");
    this.polygon.value = ""; // a second click declares nothing
    const done = await this.app.change({ do: "region", name: name || "artefact", author, reason, polygon }, `${name || "One"} declared an artefact`);
    if (done) this.name.value = this.reason.value = "";
    else this.drawn(polygon);
  }

  /**
   * List the artefacts and draw them.
   * @param {Region[]} regions those of the session
   */
  show(regions) {
    const shown = JSON.stringify(regions);
    if (shown === this.shown) return; // a button that is being pressed stays
    this.shown = shown;
    this.declared = regions.map((one) => one.polygon);
    this.maps.show(this.declared);
    this.list.replaceChildren(
      ...regions.map((one) => {
        const by = [one.reason, one.author && `by ${one.author}`].filter(Boolean).join(", ");
        const remove = () => this.app.change({ do: "unregion", id: one.id }, `${one.name} no longer an artefact`);
        return make(
          "li",
          {},
          make("strong", {}, one.name),
          by ? `: ${by} ` : " ",
          button("Remove", remove, { "aria-label": `Remove artefact ${one.name}` }),
        );
      }),
    );
  }
}

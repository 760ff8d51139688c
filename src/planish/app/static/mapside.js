/** One of the two maps of the tab Maps: its layer, and the values of it that are picked. */

import { choice, labelled, make, numbers, onNumbers, shown, typeset } from "./dom.js";
import { MapView } from "./mapview.js";

/**
 * @import {App} from "./main.js"
 * @import {Picture} from "./rawtiles.js"
 */

/**
 * A picture's name as it is read, with its unit.
 * @param {object} picture a picture of the session
 * @param {string} picture.title what it shows
 * @param {string} picture.name layer and variable
 * @param {string} picture.units ASCII
 * @returns {string}
 */
export const titled = ({ title, name, units }) =>
  `${name.includes("/") ? `${name.split("/")[0]}: ` : ""}${title}${units && units !== "1" ? `, ${typeset(units)}` : ""}`;

export class MapSide {
  /**
   * Make the map and its fields.
   * @param {object} parts what it shows, and what is called
   * @param {string} parts.side `Left` or `Right`
   * @param {Picture[]} parts.pictures those that it can show
   * @param {Picture} parts.chosen the one that it shows first
   * @param {App} parts.app session of this window
   * @param {() => void} parts.onLayer called when it shows another one
   * @param {() => void} parts.onBrush called when other values are picked
   */
  constructor({ side, pictures, chosen, app, onLayer, onBrush }) {
    this.pictures = pictures;
    this.element = make("div", { class: "view" });
    this.view = new MapView({ element: this.element, name: `${side} map`, short: side, app });
    this.layer = choice(pictures.map((one) => [one.name, titled(one)]), () => {
      this.choose();
      onLayer();
    });
    this.layer.value = chosen.name;
    this.brushField = make("input", { type: "text", size: 12, spellcheck: "false", placeholder: "low, high" });
    const needed = 'A brush is "low, high": pixels with values between both are chosen.';
    onNumbers(this.brushField, { count: 2, use: onBrush, refuse: () => app.say(needed) });
    this.brushBox = make("label", { class: "field" }, make("span", { class: "soft" }, "Brush"), this.brushField);
    this.element.prepend(make("div", { class: "head" }, labelled(`${side} layer`, this.layer)));
    this.view.fields.prepend(this.brushBox);
    this.choose();
  }

  /**
   * The picture that is shown.
   * @returns {Picture}
   */
  get picture() {
    return this.pictures.find((one) => one.name === this.layer.value);
  }

  /** Show the picture of the box, with no values picked. */
  choose() {
    this.brushField.value = "";
    this.brushField.setAttribute("aria-label", `Brush ${this.picture.name}`);
    this.brushField.title = `Only pixels whose ${this.picture.title.toLowerCase()} lies from low to high`;
    this.view.show(this.picture);
  }

  /**
   * Values that are picked, low and high; null where none are.
   * @returns {number[]|null}
   */
  get brush() {
    return numbers(this.brushField.value, 2)?.sort((a, b) => a - b) ?? null;
  }

  /**
   * Pick other values.
   * @param {number[]|null} range low and high
   */
  set brush(range) {
    this.brushField.value = range ? range.map(shown).join(", ") : "";
  }
}

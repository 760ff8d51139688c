/** One of the two maps of the tab Maps: its layer, colours, brush and histogram. */

import { histogram, shown } from "./charts.js";
import { PALETTES, paletteOf } from "./colour.js";
import { choice, labelled, make, numbers } from "./dom.js";
import { MapView } from "./mapview.js";

/** @typedef {import("./rawtiles.js").Picture} Picture */

/** A picture's title with its unit. @param {Picture & {title: string}} picture */
const titled = ({ title, name, units }) =>
  `${name.includes("/") ? `${name.split("/")[0]}: ` : ""}${title}${units && units !== "1" ? `, ${units}` : ""}`;

export class MapSide {
  /**
   * @param {{side: "Left"|"Right", pictures: Picture[], chosen: Picture, app: any, onLayer: () => void,
   *   onLook: () => void, onBrush: () => void}} options
   */
  constructor({ side, pictures, chosen, app, onLayer, onLook, onBrush }) {
    this.app = app;
    this.pictures = pictures;
    this.onLook = onLook;
    this.element = make("div", { class: "view" });
    this.view = new MapView({ element: this.element, name: `${side} map`, app });
    this.layer = choice(pictures.map((/** @type {any} */ one) => [one.name, titled(one)]), () => {
      this.choose(onLayer);
    });
    this.layer.value = chosen.name;
    this.palette = choice(Object.keys(PALETTES), onLook);
    this.rangeField = make("input", { type: "text", size: 14, spellcheck: "false" });
    this.brushField = make("input", { type: "text", size: 14, spellcheck: "false" });
    this.brushName = make("span", {}, "");
    this.brushBox = make("label", { class: "field" }, this.brushName, this.brushField);
    this.histogram = make("div");
    this.read(this.rangeField, () => onLook(), "A colour range is \"low, high\".");
    this.read(this.brushField, () => onBrush(), "A brush is \"low, high\": pixels with values between both are chosen.");
    const head = make("div", { class: "head" }, labelled(`${side} layer`, this.layer), this.view.fields);
    this.element.prepend(head);
    this.element.append(
      make(
        "div",
        { class: "head" },
        labelled("colours", this.palette, `${side} `),
        labelled("colour range", this.rangeField, `${side} `),
        this.brushBox,
      ),
      this.histogram,
    );
    this.choose(() => {});
  }

  /** @returns {Picture} */
  get picture() {
    return /** @type {Picture} */ (this.pictures.find((one) => one.name === this.layer.value));
  }

  /** @param {() => void} then */
  choose(then) {
    const { range } = this.picture;
    this.palette.value = paletteOf(this.picture);
    this.rangeField.value = this.given = range.map(shown).join(", ");
    this.counted = null;
    this.brushField.value = "";
    this.brushName.textContent = `Brush ${this.picture.name}`;
    this.view.show(this.picture);
    this.histogram.replaceChildren();
    then();
  }

  /**
   * @param {HTMLInputElement} field
   * @param {() => void} use
   * @param {string} needed
   */
  read(field, use, needed) {
    let last = field.value;
    const take = () => {
      if (field.value === last) return;
      const valid = field.value.trim() === "" || numbers(field.value, 2) !== null;
      field.setAttribute("aria-invalid", String(!valid));
      if (!valid) return this.app.say(needed);
      last = field.value;
      use();
    };
    field.addEventListener("change", take);
    field.addEventListener("keydown", (event) => event.key === "Enter" && take());
  }

  /** Values that are picked, low and high; null where none are. @returns {number[]|null} */
  get brush() {
    return numbers(this.brushField.value, 2)?.sort((a, b) => a - b) ?? null;
  }

  set brush(range) {
    this.brushField.value = range ? range.map(shown).join(", ") : "";
  }

  /** Colours and their limits. @returns {{palette: string, low: number, high: number}} */
  get look() {
    const [low, high] = numbers(this.rangeField.value, 2) ?? this.picture.range;
    return { palette: this.palette.value, low, high };
  }

  /** Draw the map with masks and brushes. @param {Omit<import("./rawtiles.js").Look, "palette">} more */
  draw(more) {
    this.view.layer.getSource().look({ ...this.look, ...more });
    if (this.counted) this.showHistogram(this.counted);
  }

  /** Show how the valid values are distributed; the first time the colours are given their range. @param {any} found */
  showHistogram(found) {
    const first = this.counted !== found;
    this.counted = found;
    if (first && this.rangeField.value === this.given) {
      this.rangeField.value = this.given = found.range.map(shown).join(", ");
      this.onLook();
    }
    const { low, high } = this.look;
    this.histogram.replaceChildren(histogram(found, this.picture, [low, high]));
  }
}

/** The tab Surfaces: slices of the volume with what was found in them, and corrections of the faces. */

import { Contrast } from "./contrast.js";
import { Corrections } from "./corrections.js";
import { button, choice, labelled, make, numbers } from "./dom.js";
import { Slice } from "./slicedata.js";
import { LINES } from "./sliceover.js";
import { SliceView } from "./sliceview.js";

/**
 * @import {App} from "./main.js"
 * @import {SliceAxis, SlicePlace, VolumePlace} from "./slicedata.js"
 * @typedef {{layer: string, rows: string, cols: string, through: string, top: string, thickness_um: number,
 *   reach_um: number, correctable: boolean, error?: string, axes: Record<string, SliceAxis>}} Sheet
 */

/** A point that lies so many thicknesses of the sheet off the face is asked about. */
const FAR = 0.5;

let tab = null;

/**
 * Fill the tab.
 * @param {HTMLElement} panel element of the tab
 * @param {App} app session of this window
 * @returns {Promise<void>}
 */
export async function mount(panel, app) {
  tab = new Tab(panel, app);
  await tab.start();
}

/**
 * Show the slice through a place of the volume; without z, through a place of the sheet's map.
 * @param {number} x_um of the volume, or of the map
 * @param {number} y_um of the volume, or of the map
 * @param {number} [z_um] of the volume
 * @param {string} [layer] sheet that it is in
 * @returns {Promise<void>}
 */
export async function showSlice(x_um, y_um, z_um, layer) {
  if (!tab?.sheet) return;
  if (z_um !== undefined) return tab.showPlace({ x: x_um, y: y_um, z: z_um, layer });
  const map = tab.app.pictures.find((one) => one.plane === "moving");
  const found = map && (await tab.app.api.get(`cursor?id=${encodeURIComponent(map.id)}&x=${x_um}&y=${y_um}`));
  if (found?.volume) await tab.showPlace(found.volume);
  else tab.app.say("There is no place of the volume under this pixel.");
}

class Tab {
  /**
   * Begin with no sheet.
   * @param {HTMLElement} panel element of the tab
   * @param {App} app session of this window
   */
  constructor(panel, app) {
    this.panel = panel;
    this.app = app;
    this.sheets = [];
    this.sheet = null;
    this.direction = "";
    this.index = 0;
    this.asked = 0;
    this.near = { across: NaN, down: NaN };
    app.showSlice = showSlice;
  }

  /**
   * Ask which layers have slices, and show the first one.
   * @returns {Promise<void>}
   */
  async start() {
    const { sheets, status } = await this.app.api.get("sheets");
    this.reasons = status;
    this.sheets = sheets.filter((one) => !one.error);
    const faults = sheets.filter((one) => one.error);
    for (const fault of faults) this.panel.append(make("p", { class: "warned" }, `${fault.layer}: ${fault.error}`));
    if (!this.sheets.length) {
      if (!faults.length) this.panel.append(make("p", {}, "This run holds no sheet of a volume, so there are no slices."));
      return;
    }
    this.build();
    this.choose(this.sheets[0].layer);
    this.app.onState(() => {
      if (this.corrections.listed() && this.direction) void this.load();
    });
  }

  // --- elements ------------------------------------------------------------------------------------------------

  /** Make the elements of the tab. */
  build() {
    this.view = new SliceView({
      onCursor: (place) => this.sayPlace(place),
      onPoint: (place) => this.addPoint(place),
      onStep: (by) => this.step(by),
      onBack: () => this.corrections.drop(),
    });
    this.layerBox = choice(this.sheets.map((one) => one.layer), (value) => this.choose(value));
    this.directionBox = choice([], (value) => this.turn(value));
    this.slider = make("input", { type: "range", min: "0", step: "1", oninput: () => this.go(Number(this.slider.value)) });
    this.placeField = make("input", { type: "text", inputmode: "decimal", class: "short", onchange: () => this.goToText() });
    const say = (text) => this.app.say(text);
    this.contrast = new Contrast({ name: "Grey range", say, onChange: () => this.setRange() });
    this.view.onWindow = (low, high) => {
      const { offset, scale } = this.view?.slice.facts;
      this.contrast?.set([offset + scale * low, offset + scale * high]);
    };
    this.corrections = new Corrections(this.app, {
      sheet: () => this.sheet, first: this.sheets[0].layer, onTry: () => this.load(), onShow: (place) => this.showPlace(place),
    });
    this.panel.classList.add("surfaces");
    const lines = make("span", { class: "group" }, ...this.lineBoxes());
    this.panel.append(
      make("div", { class: "tools" },
        this.sheets.length > 1 ? labelled("Sheet", this.layerBox) : null,
        labelled("Direction", this.directionBox), labelled("Slice", this.slider),
        labelled("Slice at, um", this.placeField),
        make("span", { class: "field grey" }, make("span", { class: "soft" }, "Grey"), this.contrast.element)),
      make("div", { class: "tools" }, lines),
      this.view.frame,
      make("div", { class: "under" }, ...this.corrections.elements),
    );
  }

  /**
   * Boxes that say which lines are drawn.
   * @returns {HTMLElement[]}
   */
  lineBoxes() {
    /** @type {[string, string, string[]][]} */
    const kinds = [
      ["faces", "Faces", [LINES[0][2], LINES[4][2]]], ["interfaces", "Interfaces", [LINES[1][2], LINES[3][2]]],
      ["centre", "Centre surface", [LINES[2][2]]], ["normals", "Normals", []], ["error", "Standard error", []],
      ["before", "Before corrections", []],
    ];
    return kinds.map(([kind, words, colours]) => {
      const box = make("input", { type: "checkbox", onchange: () => {
        if (box.checked) this.view?.shown.add(kind);
        else this.view?.shown.delete(kind);
        this.view?.draw();
      } });
      box.checked = this.view?.shown.has(kind);
      const keys = colours.map((colour) => {
        const key = make("span", { class: "key", "aria-hidden": "true" });
        key.style.background = colour;
        return key;
      });
      return make("label", { class: "check" }, box, ...keys, words);
    });
  }

  // --- which slice ---------------------------------------------------------------------------------------------

  /**
   * Look at a sheet.
   * @param {string} layer its layer
   */
  choose(layer) {
    this.sheet = this.sheets.find((one) => one.layer === layer);
    const { rows, cols, through, top } = this.sheet;
    const high = top === "high" ? "high" : "low";
    this.directionBox.replaceChildren();
    for (const [value, words] of [
      [rows, `across ${rows}`], [cols, `across ${cols}`], [through, `across ${through}, along the sheet`],
      ["straight", "straightened along the normals"],
    ]) this.directionBox.append(make("option", { value }, words));
    this.directionBox.title = `The sheet's normal runs along ${through}; its top lies at the ${high} end.`;
    this.corrections.startWith(this.sheet);
    this.turn(rows);
  }

  /**
   * Show slices of another direction.
   * @param {string} direction axis that they are cut across, or `straight`
   * @param {number} [index] which of them; the middle one where it is not given
   * @returns {Promise<void>}
   */
  turn(direction, index) {
    this.direction = direction;
    this.directionBox.value = direction;
    const { count } = this.sheet.axes[direction];
    this.slider.max = String(count - 1);
    if (this.view) this.view.acrossIsRows = direction === this.sheet.cols;
    return this.go(index ?? Math.floor(count / 2));
  }

  /**
   * Show a slice of this direction.
   * @param {number} index from the first one
   * @returns {Promise<void>}
   */
  go(index) {
    const { count, first_um: first, step_um: step } = this.sheet.axes[this.direction];
    this.index = Math.max(0, Math.min(count - 1, index));
    this.slider.value = String(this.index);
    const normal = this.direction === "straight" ? this.sheet.rows : this.direction;
    this.slider.setAttribute("aria-valuetext", `${normal} ${(first + this.index * step).toFixed(2)} um`);
    this.placeField.value = (first + this.index * step).toFixed(2);
    return this.load();
  }

  /**
   * Go on by some slices.
   * @param {number} by below 0 for those before
   */
  step(by) {
    void this.go(this.index + by);
  }

  /** Show the slice at the place of the field. */
  goToText() {
    const found = numbers(this.placeField.value, 1);
    this.placeField.setAttribute("aria-invalid", String(!found));
    if (!found) return;
    const { first_um: first, step_um: step } = this.sheet.axes[this.direction];
    void this.go(Math.round((found[0] - first) / step));
  }

  /** Take the limits of grey of the contrast. */
  setRange() {
    const facts = this.view?.slice?.facts;
    if (!this.view || !facts) return;
    const [low, high] = this.contrast.limits.map((value) => (value - facts.offset) / facts.scale);
    this.view.range = [low, high];
    this.view.paintGrey();
    this.view.draw();
  }

  /**
   * Take the slice from the server; an older answer never replaces a newer one.
   * @returns {Promise<void>}
   */
  async load() {
    const number = ++this.asked;
    this.busy?.abort();
    this.busy = new AbortController();
    const asked = new URLSearchParams();
    if (Number.isFinite(this.near.across)) asked.set("across", String(this.near.across));
    if (Number.isFinite(this.near.down)) asked.set("down", String(this.near.down));
    this.corrections.ask(asked);
    const path = `slices/${encodeURIComponent(this.sheet.layer)}/${this.direction}/${this.index}?${asked}`;
    try {
      const answer = await this.app.api.fetch(path, { signal: this.busy.signal });
      const slice = new Slice(await answer.arrayBuffer());
      if (number !== this.asked || !this.view) return;
      this.view.points = this.corrections.pointsIn(slice.facts);
      this.contrast.show({ title: "Grey of the volume", name: "grey", units: "1", range: [0, 1], shade: (share) => Array(3).fill(255 * Math.max(0, Math.min(1, share))), counted: slice.histogram() });
      const { offset, scale } = slice.facts;
      const [low, high] = this.contrast.limits;
      this.view.range = [(low - offset) / scale, (high - offset) / scale];
      this.view.show(slice);
      this.corrections.compare(slice);
      if (!this.view.cursor) this.sayPlace(null);
    } catch (error) {
      if (number === this.asked && error.name !== "AbortError") this.app.alarm(error.message);
    }
  }

  /**
   * Show the slice through a place.
   * @param {VolumePlace} place in um
   * @returns {Promise<void>}
   */
  async showPlace(place) {
    await this.app.openTab?.("surfaces");
    if (place.layer && place.layer !== this.sheet.layer && this.sheets.some((one) => one.layer === place.layer)) {
      this.layerBox.value = place.layer;
      this.choose(place.layer);
    }
    const { rows, cols, through, axes } = this.sheet;
    this.near = { across: place[cols], down: place[through] };
    await this.turn(rows, Math.round((place[rows] - axes[rows].first_um) / axes[rows].step_um));
    this.view?.goTo(place[cols], place[through], Math.max(this.view.zoom, 2 / axes[through].step_um));
  }

  // --- what is seen --------------------------------------------------------------------------------------------

  /**
   * Say what lies at the cursor.
   * @param {SlicePlace|null} at null where it is not in the slice
   */
  sayPlace(at) {
    const slice = this.view?.slice;
    if (!slice) return;
    const { facts } = slice;
    if (!at) {
      this.app.slicePosition?.(`${facts.normal} ${facts.at_um.toFixed(2)} um`);
      return;
    }
    const place = slice.place(at.across, at.down, this.sheet);
    const pixel = (axis, um) =>
      Math.round((um - axis.first_um) / axis.step_um);
    const grey = slice.value(pixel(facts.down, at.down), pixel(facts.across, at.across));
    const said = [`x ${place.x.toFixed(2)}, y ${place.y.toFixed(2)}, z ${place.z.toFixed(2)} um`];
    if (Number.isFinite(grey)) said.push(`grey ${Number(grey.toPrecision(6))}`);
    if (facts.columns) said.push(...this.columnWords(slice, at.across));
    this.app.slicePosition?.(said.join("; "));
  }

  /**
   * What the column at a place says of the faces.
   * @param {Slice} slice the slice
   * @param {number} across um along it
   * @returns {string[]}
   */
  columnWords(slice, across) {
    const said = [];
    for (const [name, words] of [["top", "top"], ["bottom", "bottom"]]) {
      const height = slice.at(name, across);
      if (Number.isFinite(height)) said.push(`${words} ${height.toFixed(2)} um`);
    }
    const error = slice.at("thickness_se", across);
    if (Number.isFinite(error)) said.push(`standard error of the thickness ${error.toFixed(2)} um`);
    const status = slice.at("status", across);
    if (Number.isFinite(status)) said.push(this.reasons[status] ?? `status ${status}`);
    const how = Math.max(slice.at("correction_top", across), slice.at("correction_bottom", across));
    if (how > 0) said.push(how === 1 ? "corrected, edge seen" : "corrected, interpolated");
    return said;
  }

  /**
   * Set a point of a correction, or ask where it lies far off.
   * @param {SlicePlace} at in the slice
   * @returns {void}
   */
  addPoint(at) {
    const slice = this.view?.slice;
    if (!slice) return;
    if (slice.facts.direction === this.sheet.through) {
      this.app.say("A slice along the sheet shows no height. Choose another direction to set points.");
      return;
    }
    const place = slice.place(at.across, at.down, this.sheet);
    const outside = Object.entries(place).some(([axis, um]) => {
      const { first_um: first, step_um: step, count } = this.sheet.axes[axis];
      return um < first - step / 2 || um > first + (count - 0.5) * step;
    });
    if (outside) return this.app.say("There is no place of the volume here.");
    const face = this.corrections.faceBox.value;
    const off = Math.abs(at.down - slice.at(face, at.across));
    if (off > FAR * this.sheet.thickness_um) this.corrections.question(place, `This point lies ${off.toFixed(0)} um from the ${face} face that was found.`);
    else this.corrections.add(place);
  }
}

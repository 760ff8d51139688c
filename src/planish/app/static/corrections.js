/** Corrections of the faces: the points of one that is made, tried on the screen before it is saved, and those saved. */

import { button, choice, labelled, make, numbers, typeset, written } from "./dom.js";

/**
 * @import {App} from "./main.js"
 * @import {Facts, Slice, SlicePoint, VolumePlace} from "./slicedata.js"
 * @import {Sheet} from "./surfaces.js"
 * @typedef {{id: string, layer?: string, reach_um: number|null, points: (VolumePlace & {face: string})[]}} Correction
 */

const MOST_POINTS = 100; // of one correction, which travel in an address while they are tried

export class Corrections {
  /**
   * Make the fields, the buttons and the list.
   * @param {App} app session of this window
   * @param {object} on the tab
   * @param {() => Sheet} on.sheet the sheet that is looked at
   * @param {string} on.first layer of the first sheet
   * @param {() => Promise<void>} on.onTry called when points change
   * @param {(place: VolumePlace) => void} on.onShow called when a point is to be seen
   */
  constructor(app, on) {
    this.app = app;
    this.on = on;
    this.draft = [];
    this.faceBox = choice([["top", "top"], ["bottom", "bottom"]], () => {});
    this.reachField = make("input", {
      type: "number", class: "short", min: "1", max: "5000", step: "any", onchange: () => this.tried(),
    });
    this.pointField = make("input", { type: "text", placeholder: "x, y, z", onchange: () => this.addText() });
    this.correctButton = button("Correct", () => this.correct(), { class: "main", disabled: true });
    this.dropButton = button("Remove point", () => this.drop(), { disabled: true });
    this.clearButton = button("Discard points", () => this.clear(), { disabled: true });
    this.list = make("ul", { class: "corrections", "aria-label": "Corrections" });
    this.note = make("p", { class: "step", "aria-live": "polite" });
    this.off = make("span", { class: "warned" });
    this.elements = [
      make("div", { class: "tools" },
        labelled("Face", this.faceBox), labelled("Reach, um", this.reachField), labelled("Point, um", this.pointField),
        this.dropButton, this.clearButton, this.correctButton),
      this.note,
      this.list,
    ];
  }

  /**
   * The sheet that is looked at.
   * @returns {Sheet}
   */
  get sheet() {
    return this.on.sheet();
  }

  /**
   * Begin anew on a sheet.
   * @param {Sheet} sheet the one that is looked at from now on
   */
  startWith(sheet) {
    this.reachField.value = String(sheet.reach_um);
    this.draft = [];
    this.tell();
    this.listed();
  }

  /**
   * Have a slice come with what the points make of it.
   * @param {URLSearchParams} asked query of the slice, which gets the points
   */
  ask(asked) {
    if (!this.draft.length) return;
    asked.set("points", this.draft.map((p) => `${p.z},${p.y},${p.x},${p.face}`).join(";"));
    asked.set("reach", this.reachField.value);
  }

  /**
   * Points of saved corrections, and of the one that is made, near a slice.
   * @param {Facts} facts those of the slice
   * @returns {SlicePoint[]}
   */
  pointsIn(facts) {
    if (facts.direction === "straight") return [];
    const saved = this.saved().flatMap((one) => one.points.map((p) => ({ ...p, draft: false })));
    const made = this.draft.map((p) => ({ ...p, draft: true }));
    const reach = Number(this.reachField.value) || 0;
    const size = Math.abs(this.sheet.axes[facts.normal].step_um);
    return [...saved, ...made]
      .filter((p) => Math.abs(p[facts.normal] - facts.at_um) <= Math.max(reach, size))
      .map((p) => ({
        across: p[facts.across.name], down: p[facts.down.name], face: p.face, draft: p.draft,
        here: Math.abs(p[facts.normal] - facts.at_um) <= 0.5 * size,
      }));
  }

  /**
   * Saved corrections of this sheet.
   * @returns {Correction[]}
   */
  saved() {
    const all = this.app.state.corrections ?? [];
    return all.filter((one) => (one.layer ?? this.on.first) === this.sheet.layer);
  }

  /** Set a point where the field says. */
  addText() {
    const found = numbers(this.pointField.value, 3);
    this.pointField.setAttribute("aria-invalid", String(!found));
    if (!found) return;
    this.pointField.value = "";
    this.add({ x: found[0], y: found[1], z: found[2] });
  }

  /**
   * Set a point.
   * @param {VolumePlace} place in um
   */
  add(place) {
    if (this.app.readOnly) {
      this.app.say("The run is open read-only.");
      return;
    }
    if (!this.sheet.correctable) {
      this.app.say("The faces of this sheet were not found by their grey and cannot be corrected.");
      return;
    }
    if (![place.x, place.y, place.z].every(Number.isFinite)) {
      this.app.say("There is no place of the volume here.");
      return;
    }
    if (this.draft.length >= MOST_POINTS) {
      this.app.say(`A correction has ${MOST_POINTS} points at most. Press Correct and go on with another.`);
      return;
    }
    const round = (value) => Math.round(value * 1000) / 1000;
    this.draft.push({ x: round(place.x), y: round(place.y), z: round(place.z), face: this.faceBox.value });
    this.tried();
  }

  /**
   * Ask whether a point is meant that lies far off.
   * @param {VolumePlace} place in um
   * @param {string} words why it is asked
   */
  question(place, words) {
    const answered = (yes) => () => {
      if (yes) this.add(place);
      else this.tell();
    };
    const yes = button("Set it", answered(true));
    this.note.replaceChildren(make("span", { class: "warned" }, `${typeset(words)} Set it anyway? `), yes, " ", button("Leave it out", answered(false)));
    yes.focus();
  }

  /**
   * Say where the green line does not go through the points.
   * @param {Slice} slice with the faces as the points make them
   */
  compare(slice) {
    const { across, down, normal } = slice.facts;
    const size = Math.abs(this.sheet.axes[normal]?.step_um ?? 0);
    const off = this.draft
      .filter((p) => Math.abs(p[normal] - slice.facts.at_um) <= 0.5 * size)
      .map((p) => Math.abs(slice.at(`preview_${p.face}`, p[across.name]) - p[down.name]));
    const most = Math.max(0, ...off.filter(Number.isFinite));
    this.off.textContent =
      most > 2 * Math.abs(down.step_um)
        ? ` The green line misses a point by ${most.toFixed(1)} µm: the image shows an edge there, or another point disagrees. Set more points, or remove it.`
        : "";
  }

  /** Take the last point away. */
  drop() {
    if (this.draft.pop()) this.tried();
  }

  /** Take all points away. */
  clear() {
    this.draft = [];
    this.tried();
  }

  /**
   * Show what the points would make of the faces.
   * @returns {Promise<void>}
   */
  tried() {
    this.tell();
    return this.on.onTry();
  }

  /** Say how many points there are and where the last one lies. */
  tell() {
    const count = this.draft.length;
    for (const one of [this.dropButton, this.clearButton, this.correctButton]) one.disabled = !count;
    const last = this.draft.at(-1);
    const at = last && written([last.x, last.y, last.z]);
    const points = `${count} point${count > 1 ? "s" : ""}`;
    this.note.replaceChildren(last ? `${points}, the last at x, y, z = ${at} µm on the ${last.face} face.` : "", this.off);
  }

  /**
   * Save the points as a correction.
   * @returns {Promise<void>}
   */
  async correct() {
    const points = this.draft.map(({ x, y, z, face }) => ({ z, y, x, face }));
    const reach = Number(this.reachField.value);
    if (!points.length) return;
    const done = await this.app.change(
      { do: "correct", layer: this.sheet.layer, points, reach_um: reach > 0 ? reach : null }, "Correction made",
    );
    if (done) this.clear();
  }

  /**
   * List what is saved.
   * @returns {boolean} whether that is something else than before
   */
  listed() {
    const kept = this.saved();
    const shown = JSON.stringify(kept);
    if (shown === this.seen) return false;
    this.seen = shown;
    this.list.replaceChildren(...kept.map((one) => this.row(one)));
    return true;
  }

  /**
   * The row of a correction.
   * @param {Correction} one saved
   * @returns {HTMLElement}
   */
  row(one) {
    const faces = [...new Set(one.points.map((p) => p.face))].join(" and ");
    const middle = one.points[Math.floor(one.points.length / 2)];
    const points = `${one.points.length} point${one.points.length > 1 ? "s" : ""}`;
    const { layer } = this.sheet;
    const remove = () => this.app.change({ do: "uncorrect", id: one.id, layer }, "Correction removed");
    return make("li", {},
      `${one.id}: ${points} on the ${faces} face, reach ${one.reach_um ?? this.sheet.reach_um} µm `,
      button("Show", () => this.on.onShow({ layer, ...middle }), { "aria-label": `Show ${one.id}` }),
      button("Remove", remove, { "aria-label": `Remove correction ${one.id}`, disabled: this.app.readOnly }));
  }
}

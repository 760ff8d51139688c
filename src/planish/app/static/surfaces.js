/** The tab Surfaces: slices of the volume with what was found in them, and corrections of the faces. */

import { button, choice, labelled, make, numbers, written } from "./dom.js";
import { Slice } from "./slicedata.js";
import { LINES, SliceView } from "./sliceview.js";

const MOST_POINTS = 100; // of one correction, which travel in an address while they are tried

/** @type {Tab|null} */
let tab = null;

/** @param {HTMLElement} panel @param {any} app */
export async function mount(panel, app) {
  tab = new Tab(panel, app);
  await tab.start();
}

/**
 * Show the slice through a place of the volume; without z, through a place of the sheet's map.
 * @param {number} x_um
 * @param {number} y_um
 * @param {number} [z_um]
 * @param {string} [layer] sheet that it is in
 */
export async function showSlice(x_um, y_um, z_um, layer) {
  if (!tab?.sheet) return;
  if (z_um !== undefined) return tab.showPlace({ x: x_um, y: y_um, z: z_um, layer });
  const map = tab.app.pictures.find((/** @type {any} */ one) => one.plane === "moving");
  const found = map && (await tab.app.api.get(`cursor?id=${encodeURIComponent(map.id)}&x=${x_um}&y=${y_um}`));
  if (found?.volume) await tab.showPlace(found.volume);
  else tab.app.say("There is no place of the volume under this pixel.");
}

class Tab {
  /** @param {HTMLElement} panel @param {any} app */
  constructor(panel, app) {
    this.panel = panel;
    this.app = app;
    /** @type {any[]} */
    this.sheets = [];
    /** @type {any} */
    this.sheet = null;
    this.direction = "";
    this.index = 0;
    /** @type {{x: number, y: number, z: number, face: string}[]} */
    this.draft = [];
    this.asked = 0;
    this.near = { across: NaN, down: NaN };
    app.showSlice = showSlice;
  }

  async start() {
    const { sheets, status } = await this.app.api.get("sheets");
    this.reasons = status;
    this.sheets = sheets.filter((/** @type {any} */ one) => !one.error);
    const faults = sheets.filter((/** @type {any} */ one) => one.error);
    for (const fault of faults) this.panel.append(make("p", { class: "warned" }, `${fault.layer}: ${fault.error}`));
    if (!this.sheets.length) {
      if (!faults.length) this.panel.append(make("p", {}, "This run holds no sheet of a volume, so there are no slices."));
      return;
    }
    this.build();
    this.choose(this.sheets[0].layer);
    this.app.onState(() => this.onState());
  }

  // --- elements ------------------------------------------------------------------------------------------------

  build() {
    this.view = new SliceView({
      onCursor: (place) => this.sayPlace(place),
      onPoint: (place) => this.addPoint(place),
      onStep: (by) => this.step(by),
      onBack: () => this.dropPoint(),
    });
    this.layerBox = choice(this.sheets.map((one) => one.layer), (value) => this.choose(value));
    this.directionBox = choice([], (value) => this.turn(value));
    this.slider = make("input", { type: "range", min: "0", step: "1", oninput: () => this.go(Number(this.slider.value)) });
    this.placeField = make("input", { type: "text", inputmode: "decimal", class: "short", onchange: () => this.goToText() });
    this.rangeField = make("input", { type: "text", class: "short", onchange: () => this.setRange() });
    this.faceBox = choice([["top", "top"], ["bottom", "bottom"]], () => {});
    this.reachField = make("input", { type: "number", class: "short", min: "1", max: "5000", step: "any", onchange: () => this.tried() });
    this.pointField = make("input", { type: "text", placeholder: "x, y, z", onchange: () => this.addText() });
    this.correctButton = button("Correct", () => this.correct(), { class: "main", disabled: true });
    this.dropButton = button("Remove point", () => this.dropPoint(), { disabled: true });
    this.clearButton = button("Discard points", () => this.clear(), { disabled: true });
    this.list = make("ul", { class: "corrections", "aria-label": "Corrections" });
    this.note = make("p", { class: "step", "aria-live": "polite" });
    this.panel.classList.add("surfaces");
    const lines = make("span", { class: "group" }, ...this.lineBoxes());
    this.panel.append(
      make("div", { class: "tools" },
        this.sheets.length > 1 ? labelled("Sheet", this.layerBox) : null,
        labelled("Direction", this.directionBox), labelled("Slice", this.slider),
        labelled("Slice at, um", this.placeField), labelled("Grey range", this.rangeField),
        button("Whole slice", () => this.view?.whole())),
      make("div", { class: "tools" }, lines),
      this.view.frame,
      make("div", { class: "under" },
        make("div", { class: "tools" },
          labelled("Face", this.faceBox), labelled("Reach, um", this.reachField), labelled("Point, um", this.pointField),
          this.dropButton, this.clearButton, this.correctButton),
        this.note, this.list,
        make("p", { class: "soft help" },
          "Click, or Enter, sets a point on the face that is chosen; the green line shows the face as Correct and then ",
          "Apply will make it. Drag moves the slice, the wheel or + and - zoom, Home shows all of it. Arrows move the ",
          "cursor by a screen pixel (Shift: 5), Page Up and Page Down go to the slice before and after (Shift: 10), ",
          "Backspace removes the last point.")),
    );
  }

  lineBoxes() {
    const kinds = [
      ["faces", "Faces", [LINES[0][2], LINES[4][2]]], ["interfaces", "Interfaces", [LINES[1][2], LINES[3][2]]],
      ["centre", "Centre surface", [LINES[2][2]]], ["normals", "Normals", []], ["error", "Standard error", []],
      ["before", "Before corrections", []],
    ];
    return kinds.map(([kind, words, colours]) => {
      const box = make("input", { type: "checkbox", onchange: () => {
        if (box.checked) this.view?.shown.add(String(kind));
        else this.view?.shown.delete(String(kind));
        this.view?.draw();
      } });
      box.checked = this.view?.shown.has(String(kind));
      const keys = /** @type {string[]} */ (colours).map((colour) => {
        const key = make("span", { class: "key", "aria-hidden": "true" });
        key.style.background = colour;
        return key;
      });
      return make("label", { class: "check" }, box, ...keys, String(words));
    });
  }

  // --- which slice ---------------------------------------------------------------------------------------------

  /** @param {string} layer */
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
    this.reachField.value = String(this.sheet.reach_um);
    this.clear(false);
    this.turn(rows);
  }

  /** @param {string} direction @param {number} [index] */
  turn(direction, index) {
    this.direction = direction;
    this.directionBox.value = direction;
    const { count } = this.sheet.axes[direction];
    this.slider.max = String(count - 1);
    if (this.view) this.view.acrossIsRows = direction === this.sheet.cols;
    return this.go(index ?? Math.floor(count / 2));
  }

  /** @param {number} index */
  go(index) {
    const { count, first_um: first, step_um: step } = this.sheet.axes[this.direction];
    this.index = Math.max(0, Math.min(count - 1, index));
    this.slider.value = String(this.index);
    const normal = this.direction === "straight" ? this.sheet.rows : this.direction;
    this.slider.setAttribute("aria-valuetext", `${normal} ${(first + this.index * step).toFixed(2)} um`);
    this.placeField.value = (first + this.index * step).toFixed(2);
    return this.load();
  }

  /** @param {number} by */
  step(by) {
    void this.go(this.index + by);
  }

  goToText() {
    const found = numbers(this.placeField.value, 1);
    this.placeField.setAttribute("aria-invalid", String(!found));
    if (!found) return;
    const { first_um: first, step_um: step } = this.sheet.axes[this.direction];
    void this.go(Math.round((found[0] - first) / step));
  }

  setRange() {
    const found = numbers(this.rangeField.value, 2);
    const empty = !this.rangeField.value.trim();
    this.rangeField.setAttribute("aria-invalid", String(!found && !empty));
    const facts = this.view?.slice?.facts;
    if (!this.view || !facts || (!found && !empty)) return;
    const code = (/** @type {number} */ value) => (value - facts.offset) / facts.scale;
    this.view.range = found ? [code(found[0]), code(found[1])] : null;
    this.view.paintGrey();
    this.view.draw();
  }

  /** Take the slice from the server; an older answer never replaces a newer one. */
  async load() {
    const number = ++this.asked;
    this.busy?.abort();
    this.busy = new AbortController();
    const asked = new URLSearchParams();
    if (Number.isFinite(this.near.across)) asked.set("across", String(this.near.across));
    if (Number.isFinite(this.near.down)) asked.set("down", String(this.near.down));
    if (this.draft.length) {
      asked.set("points", this.draft.map((p) => `${p.z},${p.y},${p.x},${p.face}`).join(";"));
      asked.set("reach", this.reachField.value);
    }
    const path = `slices/${encodeURIComponent(this.sheet.layer)}/${this.direction}/${this.index}?${asked}`;
    try {
      const answer = await this.app.api.fetch(path, { signal: this.busy.signal });
      const slice = new Slice(await answer.arrayBuffer());
      if (number !== this.asked || !this.view) return;
      this.view.points = this.pointsIn(slice);
      this.view.show(slice);
      if (!this.view.cursor) this.sayPlace(null);
    } catch (/** @type {any} */ error) {
      if (number === this.asked && error.name !== "AbortError") this.app.alarm(error.message);
    }
  }

  /** Show the slice through a place. @param {any} place */
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

  /** @param {{across: number, down: number}|null} at */
  sayPlace(at) {
    const slice = this.view?.slice;
    if (!slice) return;
    const { facts } = slice;
    if (!at) {
      this.app.slicePosition?.(`${facts.normal} ${facts.at_um.toFixed(2)} um`);
      return;
    }
    const place = slice.place(at.across, at.down, this.sheet);
    const pixel = (/** @type {import("./slicedata.js").Axis} */ axis, /** @type {number} */ um) =>
      Math.round((um - axis.first_um) / axis.step_um);
    const grey = slice.value(pixel(facts.down, at.down), pixel(facts.across, at.across));
    const said = [`x ${place.x.toFixed(2)}, y ${place.y.toFixed(2)}, z ${place.z.toFixed(2)} um`];
    if (Number.isFinite(grey)) said.push(`grey ${Number(grey.toPrecision(6))}`);
    if (facts.columns) said.push(...this.columnWords(slice, at.across));
    this.app.slicePosition?.(said.join("; "));
  }

  /** @param {Slice} slice @param {number} across */
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

  /** Points of saved corrections, and of the one that is made, near a slice. @param {Slice} slice */
  pointsIn(slice) {
    const { facts } = slice;
    if (facts.direction === "straight") return [];
    const saved = this.corrections().flatMap((one) => one.points.map((/** @type {any} */ p) => ({ ...p, draft: false })));
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

  // --- corrections ---------------------------------------------------------------------------------------------

  /** Saved corrections of this sheet. @returns {any[]} */
  corrections() {
    const first = this.sheets[0].layer;
    return (this.app.state.corrections ?? []).filter((/** @type {any} */ one) => (one.layer ?? first) === this.sheet.layer);
  }

  /** @param {{across: number, down: number}} at */
  addPoint(at) {
    const slice = this.view?.slice;
    if (!slice) return;
    if (slice.facts.direction === this.sheet.through) {
      this.app.say("A slice along the sheet shows no height. Choose another direction to set points.");
      return;
    }
    const place = slice.place(at.across, at.down, this.sheet);
    this.addPlace(place);
  }

  addText() {
    const found = numbers(this.pointField.value, 3);
    this.pointField.setAttribute("aria-invalid", String(!found));
    if (!found) return;
    this.pointField.value = "";
    this.addPlace({ x: found[0], y: found[1], z: found[2] });
  }

  /** @param {{x: number, y: number, z: number}} place */
  addPlace(place) {
    if (this.app.readOnly || !this.sheet.correctable) {
      this.app.say(this.app.readOnly ? "The run is open to read only." : "The faces of this sheet were not found by their grey and cannot be corrected.");
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
    const round = (/** @type {number} */ value) => Math.round(value * 1000) / 1000;
    this.draft.push({ x: round(place.x), y: round(place.y), z: round(place.z), face: this.faceBox.value });
    this.tried();
  }

  dropPoint() {
    if (this.draft.pop()) this.tried();
  }

  /** @param {boolean} [anew] */
  clear(anew = true) {
    this.draft = [];
    if (anew) this.tried();
  }

  /** Show what the points would make of the faces. */
  tried() {
    const count = this.draft.length;
    for (const one of [this.dropButton, this.clearButton, this.correctButton]) one.disabled = !count;
    const last = this.draft.at(-1);
    this.note.textContent = last
      ? `${count} point${count > 1 ? "s" : ""}, the last at x, y, z = ${written([last.x, last.y, last.z])} um on the ${last.face} face.`
      : "";
    return this.load();
  }

  async correct() {
    const points = this.draft.map(({ x, y, z, face }) => ({ z, y, x, face }));
    const reach = Number(this.reachField.value);
    if (!points.length) return;
    const done = await this.app.change(
      { do: "correct", layer: this.sheet.layer, points, reach_um: reach > 0 ? reach : null }, "Correction made",
    );
    if (done) this.clear();
  }

  onState() {
    const kept = this.corrections();
    const shown = JSON.stringify(kept);
    if (shown === this.seen) return;
    this.seen = shown;
    this.list.replaceChildren(...kept.map((one) => this.row(one)));
    if (this.direction) void this.load();
  }

  /** @param {any} one */
  row(one) {
    const faces = [...new Set(one.points.map((/** @type {any} */ p) => p.face))].join(" and ");
    const middle = one.points[Math.floor(one.points.length / 2)];
    return make("li", {},
      `${one.id}: ${one.points.length} point${one.points.length > 1 ? "s" : ""} on the ${faces} face, reach ${one.reach_um ?? this.sheet.reach_um} um `,
      button("Show", () => this.showPlace({ layer: this.sheet.layer, ...middle }), { "aria-label": `Show ${one.id}` }),
      button("Remove", () => this.app.change({ do: "uncorrect", id: one.id, layer: this.sheet.layer }, "Correction removed"), {
        "aria-label": `Remove correction ${one.id}`, disabled: this.app.readOnly,
      }));
  }
}

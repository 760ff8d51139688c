/** The table of marks: one row a pair, newest last unless a header sorts it. */

import { make } from "./dom.js";

/**
 * @typedef {import("./store.js").Mark} Mark
 * @typedef {{name: string, value: (mark: Mark) => any, error?: boolean, text?: boolean}} Column
 */

const place = (/** @type {"moving"|"fixed"} */ side, /** @type {0|1} */ axis) => (/** @type {Mark} */ mark) =>
  /** @type {number[]} */ (mark[side])[axis];

/** @type {Column[]} */
const COLUMNS = [
  { name: "Mark", value: (mark) => mark.label, text: true },
  { name: "Used", value: (mark) => Number(mark.used), text: true },
  { name: "Volume x um", value: place("moving", 0) },
  { name: "Volume y um", value: place("moving", 1) },
  { name: "Image x um", value: place("fixed", 0) },
  { name: "Image y um", value: place("fixed", 1) },
  { name: "Residual um", value: (mark) => mark.residual_um, error: true },
  { name: "Leave-one-out um", value: (mark) => mark.leave_one_out_um, error: true },
];

/** From how many medians of the marks in use on an error is drawn as large, and as very large. */
const LARGE = 2;
const VERY_LARGE = 4;

export class MarkTable {
  /**
   * @param {{choose: (id: any) => void, use: (mark: Mark, used: boolean) => void}} actions
   */
  constructor(actions) {
    this.actions = actions;
    this.sorted = { column: -1, falling: false };
    /** @type {Mark[]} */
    this.marks = [];
    /** @type {any} */
    this.chosen = null;
    this.heads = COLUMNS.map((column, i) =>
      make(
        "th",
        { scope: "col", "aria-sort": "none", class: column.text ? null : "n" },
        make("button", { type: "button", onclick: () => this.sortBy(i) }, column.name),
      ),
    );
    this.heads.push(make("th", { scope: "col" }, "Note"));
    this.body = make("tbody");
    this.empty = make("p", { class: "soft" });
    const table = make("table", { "aria-label": "Marks" }, make("thead", {}, make("tr", {}, ...this.heads)), this.body);
    const scroll = { class: "scroll", role: "group", "aria-label": "Table of marks", tabindex: 0 };
    this.element = make("div", scroll, table, this.empty);
  }

  /**
   * @param {import("./store.js").State} state
   * @param {any} chosen
   */
  show(state, chosen) {
    this.marks = state.marks.filter((mark) => mark.moving && mark.fixed);
    this.chosen = chosen;
    this.notes = new Map(state.marks.map((mark) => [mark.id, mark.note ? [mark.note] : []]));
    for (const { id, text } of state.warnings ?? []) if (id !== undefined && id !== null) this.notes.get(id)?.push(text);
    const none = "No pair yet: click a hole in one view, then the same hole in the other.";
    this.empty.textContent = this.marks.length ? "" : none;
    this.draw();
  }

  /** Sort by a column: errors fall first, all else rises first; a third time gives the order of making. @param {number} i */
  sortBy(i) {
    const first = COLUMNS[i].error ?? false;
    if (this.sorted.column !== i) this.sorted = { column: i, falling: first };
    else if (this.sorted.falling === first) this.sorted = { column: i, falling: !first };
    else this.sorted = { column: -1, falling: false };
    this.heads.slice(0, COLUMNS.length).forEach((head, k) => {
      const sort = k !== this.sorted.column ? "none" : this.sorted.falling ? "descending" : "ascending";
      head.setAttribute("aria-sort", sort);
    });
    this.draw();
    this.element.scrollTop = 0;
  }

  /** The marks in the order of the rows. @returns {Mark[]} */
  get ordered() {
    const { column, falling } = this.sorted;
    if (column < 0) return this.marks;
    const value = COLUMNS[column].value;
    return [...this.marks].sort((one, other) => {
      const [a, b] = [value(one), value(other)];
      if (a === null || b === null) return Number(a === null) - Number(b === null); // what is not known stands last
      const order = typeof a === "string" ? a.localeCompare(b, undefined, { numeric: true }) : a - b;
      return falling ? -order : order;
    });
  }

  draw() {
    const focused = /** @type {HTMLElement|null} */ (document.activeElement)?.dataset.key;
    this.typical = COLUMNS.map((column) => (column.error ? median(this.marks.filter((m) => m.used).map(column.value)) : 0));
    this.largest = COLUMNS.map((column) => (column.error ? Math.max(0, ...this.marks.map((m) => column.value(m) ?? 0)) : 0));
    this.body.replaceChildren(...this.ordered.map((mark) => this.row(mark)));
    if (focused) this.body.querySelector(`[data-key="${CSS.escape(focused)}"]`)?.focus();
  }

  /** @param {Mark} mark */
  row(mark) {
    const notes = this.notes?.get(mark.id) ?? [];
    const used = make("input", {
      type: "checkbox",
      "aria-label": `Use ${mark.label}`,
      "data-key": `use ${mark.id}`,
      onchange: () => this.actions.use(mark, used.checked),
    });
    used.checked = mark.used;
    const label = make(
      "button",
      { type: "button", class: "plain", "data-key": `mark ${mark.id}`, onclick: () => this.actions.choose(mark.id) },
      mark.label,
    );
    const row = make(
      "tr",
      { class: mark.used ? null : "unused", "aria-current": mark.id === this.chosen ? "true" : null },
      make("td", {}, label),
      make("td", {}, used),
      ...COLUMNS.slice(2).map((column, k) => this.cell(column, mark, k + 2)),
      make("td", { class: notes.length ? "warned" : null }, notes.join(" ")),
    );
    row.addEventListener("click", (/** @type {MouseEvent} */ event) => {
      if (!(event.target instanceof HTMLInputElement) && !(event.target instanceof HTMLButtonElement)) {
        this.actions.choose(mark.id);
      }
    });
    return row;
  }

  /** @param {Column} column @param {Mark} mark @param {number} i */
  cell(column, mark, i) {
    const value = column.value(mark);
    if (value === null || value === undefined) return make("td", { class: "n" }, "–");
    const cell = make("td", { class: "n" }, value.toFixed(2));
    if (!column.error || !this.largest?.[i]) return cell;
    const times = value / (this.typical?.[i] || value);
    cell.classList.add("error", times >= VERY_LARGE ? "very" : times >= LARGE ? "large" : "usual");
    cell.style.setProperty("--share", `${(100 * value) / this.largest[i]}%`);
    return cell;
  }

  /** Bring the chosen row into sight. */
  reveal() {
    this.body.querySelector("[aria-current]")?.scrollIntoView({ block: "nearest" });
  }
}

/** @param {(number|null)[]} values */
function median(values) {
  const known = /** @type {number[]} */ (values.filter((value) => value !== null)).sort((a, b) => a - b);
  const middle = known.length >> 1;
  return known.length % 2 ? known[middle] : known.length ? (known[middle - 1] + known[middle]) / 2 : 0;
}

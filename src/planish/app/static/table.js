/** The table of marks: one row a pair, newest last unless a header sorts it. */

import { make, shown, typeset } from "./dom.js";

/**
 * @import {Mark, MarkId, Side, State} from "./store.js"
 * @typedef {{name: string, value: (mark: Mark) => any, error?: boolean, text?: boolean}} Column
 * @typedef {{choose: (id: MarkId) => void, use: (mark: Mark, used: boolean) => void}} RowActions
 */

/**
 * Gives one coordinate of a mark.
 * @param {Side} side plane of the end
 * @param {number} axis 0 for x, 1 for y
 * @returns {(mark: Mark) => number}
 */
const place = (side, axis) => (mark) => mark[side][axis];

/**
 * The columns of the table.
 * @param {Record<Side, string>} names those of both views
 * @returns {Column[]}
 */
const columnsOf = ({ moving, fixed }) => [
  { name: "Mark", value: (mark) => mark.label, text: true },
  { name: "Used", value: (mark) => Number(mark.used), text: true },
  { name: `${moving.replace(" side", "")} x um`, value: place("moving", 0) },
  { name: `${moving.replace(" side", "")} y um`, value: place("moving", 1) },
  { name: `${fixed.replace(" side", "")} x um`, value: place("fixed", 0) },
  { name: `${fixed.replace(" side", "")} y um`, value: place("fixed", 1) },
  { name: "Residual um", value: (mark) => mark.residual_um, error: true },
  { name: "Leave-one-out um", value: (mark) => mark.leave_one_out_um, error: true },
];

/** How many times the limit of the check asks for a look an error makes it fail. */
const FAILS = 5;

export class MarkTable {
  /**
   * Make the table.
   * @param {RowActions} actions what its buttons and boxes do
   * @param {object} facts of the registration
   * @param {Record<Side, string>} facts.names those of both views
   * @param {number|null} facts.limit_um from where on the check of the marks asks for a look
   */
  constructor(actions, { names, limit_um }) {
    this.actions = actions;
    this.limit = limit_um ?? Infinity;
    this.columns = columnsOf(names);
    this.sorted = { column: -1, falling: false };
    this.marks = [];
    this.chosen = null;
    this.rows = new Map();
    this.heads = this.columns.map((column, i) =>
      make(
        "th",
        { scope: "col", "aria-sort": "none", class: column.text ? null : "n" },
        make("button", { type: "button", "aria-label": column.name, onclick: () => this.sortBy(i) }, typeset(column.name)),
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
   * Show another state of the session.
   * @param {State} state the new one
   * @param {MarkId|null} chosen the mark that is chosen
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

  /**
   * Sort by a column: errors fall first, all else rises first; a third time gives the order of making.
   * @param {number} i the column
   */
  sortBy(i) {
    const first = this.columns[i].error ?? false;
    if (this.sorted.column !== i) this.sorted = { column: i, falling: first };
    else if (this.sorted.falling === first) this.sorted = { column: i, falling: !first };
    else this.sorted = { column: -1, falling: false };
    this.heads.slice(0, this.columns.length).forEach((head, k) => {
      const sort = k !== this.sorted.column ? "none" : this.sorted.falling ? "descending" : "ascending";
      head.setAttribute("aria-sort", sort);
    });
    this.draw();
    this.element.scrollTop = 0;
  }

  /**
   * The marks in the order of the rows.
   * @returns {Mark[]}
   */
  get ordered() {
    const { column, falling } = this.sorted;
    if (column < 0) return this.marks;
    const value = this.columns[column].value;
    return [...this.marks].sort((one, other) => {
      const [a, b] = [value(one), value(other)];
      if (a === null || b === null) return Number(a === null) - Number(b === null); // what is not known stands last
      const order = typeof a === "string" ? a.localeCompare(b, undefined, { numeric: true }) : a - b;
      return falling ? -order : order;
    });
  }

  /**
   * Draw the rows. They stay in the page while their marks do: a row made anew between the press and the release of a
   * button loses the click.
   */
  draw() {
    const largest = this.columns.map((column) => (column.error ? Math.max(Number.isFinite(this.limit) ? this.limit : 1e-9, ...this.marks.map((m) => column.value(m) ?? 0)) : 0));
    const rows = this.ordered.map((mark) => {
      const row = this.rows.get(mark.id) ?? new Row(mark, this.columns, this.actions);
      row.show(mark, this.notes?.get(mark.id) ?? [], mark.id === this.chosen, (i) => [this.limit, largest[i]]);
      return row;
    });
    this.rows = new Map(rows.map((row) => [row.mark.id, row]));
    const elements = rows.map((row) => row.element);
    if (elements.length === this.body.rows.length && elements.every((element, i) => element === this.body.rows[i])) return;
    const focused = /** @type {HTMLElement} */ (document.activeElement);
    const held = this.body.contains(focused);
    this.body.replaceChildren(...elements);
    if (held && focused?.isConnected) focused.focus();
  }

  /** Bring the chosen row into sight. */
  reveal() {
    this.body.querySelector("[aria-current]")?.scrollIntoView({ block: "nearest" });
  }
}

/** A row of the table. */
class Row {
  /**
   * Make a row.
   * @param {Mark} mark its mark
   * @param {Column[]} columns those of the table
   * @param {RowActions} actions what its button and box do
   */
  constructor(mark, columns, actions) {
    this.mark = mark;
    this.columns = columns;
    this.used = make("input", { type: "checkbox", onchange: () => actions.use(this.mark, this.used.checked) });
    this.label = make("button", { type: "button", class: "plain", onclick: () => actions.choose(this.mark.id) });
    this.cells = columns.slice(2).map(() => make("td"));
    this.note = make("td");
    this.element = make("tr", {}, make("td", {}, this.label), make("td", {}, this.used), ...this.cells, this.note);
    this.element.addEventListener("click", (event) => {
      const own = event.target instanceof HTMLInputElement || event.target instanceof HTMLButtonElement;
      if (!own) actions.choose(this.mark.id);
    });
  }

  /**
   * Show a mark as it is now.
   * @param {Mark} mark the mark
   * @param {string[]} notes what is to be said of it
   * @param {boolean} chosen whether it is chosen
   * @param {(i: number) => number[]} errors limit of the check and largest value of a column of errors
   */
  show(mark, notes, chosen, errors) {
    this.mark = mark;
    this.element.className = mark.used ? "" : "unused";
    if (chosen) this.element.setAttribute("aria-current", "true");
    else this.element.removeAttribute("aria-current");
    written(this.label, mark.label);
    this.used.setAttribute("aria-label", `Use ${mark.label}`);
    this.used.checked = mark.used;
    this.used.indeterminate = mark.used && mark.without_weight; // asked for, and not used by the fit
    this.used.title = this.used.indeterminate ? "The fit gives it no weight" : "";
    this.cells.forEach((cell, k) => this.cell(cell, this.columns[k + 2], errors(k + 2)));
    written(this.note, typeset(notes.join(" ")));
    this.note.className = notes.length ? "warned" : "";
  }

  /**
   * Write a value.
   * @param {HTMLElement} cell where
   * @param {Column} column what
   * @param {number[]} range limit of the check and largest value of the column
   */
  cell(cell, column, [limit, largest]) {
    const value = column.value(this.mark) ?? null;
    written(cell, value === null ? "–" : value.toFixed(2));
    cell.className = "n";
    if (value === null || !column.error) return;
    cell.classList.add("error", value > FAILS * limit ? "very" : value > limit ? "large" : "usual");
    if (Number.isFinite(limit)) cell.title = `The check of the marks asks for a look from ${shown(limit)} µm on, and fails from ${shown(FAILS * limit)} µm on.`;
    cell.style.setProperty("--share", `${(100 * value) / largest}%`);
  }
}

/**
 * Write a text where it is another.
 * @param {HTMLElement} element where
 * @param {string} text what
 */
function written(element, text) {
  if (element.textContent !== text) element.textContent = text;
}

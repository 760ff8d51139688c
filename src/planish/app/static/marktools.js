/** The tools of the marks: above the views the model and its error, below them what can be done with the chosen mark. */

import { button, choice, labelled, make } from "./dom.js";
import { pairsOf } from "./linked.js";

/**
 * @import {App} from "./main.js"
 * @import {Mark, State} from "./store.js"
 */

export class MarkTools {
  /**
   * Make the tools.
   * @param {App} app session of this window
   * @param {object} marks the tab
   * @param {() => void} marks.snap moves the chosen mark to the middle of its hole
   * @param {() => void} marks.remove deletes the chosen mark
   * @param {(step: number) => void} marks.walk chooses another mark
   */
  constructor(app, marks) {
    this.app = app;
    this.model = choice(app.session.models ?? [app.state.model], (model) =>
      app.change({ do: "model", model }, `Model ${model}`),
    );
    this.fit = make("span", { class: "fit" });
    this.label = make("input", { type: "text", size: 10, maxlength: 200, onchange: () => this.relabel() });
    this.snap = button("Snap", () => marks.snap(), { title: "Move both ends to the middle of the hole" });
    this.remove = button("Delete", () => marks.remove(), { title: "Delete the chosen mark" });
    const chosen = make(
      "div",
      { class: "group", role: "group", "aria-label": "Chosen mark" },
      button("Previous", () => marks.walk(-1), { title: "P in a view" }),
      button("Next", () => marks.walk(1), { title: "N in a view" }),
      labelled("Label", this.label),
      this.snap,
      this.remove,
    );
    const model = make("div", { class: "group" }, labelled("Model", this.model), this.fit);
    this.above = make("div", { class: "tools" }, model);
    this.below = make("div", { class: "tools" }, chosen);
    this.mark = null;
  }

  /**
   * Give the chosen mark the label of the field.
   * @returns {Promise<void>}
   */
  async relabel() {
    const label = this.label.value.trim();
    if (this.mark && label && label !== this.mark.label) {
      await this.app.change({ do: "label", id: this.mark.id, label }, `Mark called ${label}`);
    }
  }

  /**
   * Show another state of the session.
   * @param {State} state the new one
   * @param {Mark|null} mark the one that is chosen
   */
  show(state, mark) {
    const fixed = this.app.readOnly;
    if (document.activeElement !== this.label || mark?.id !== this.mark?.id) this.label.value = mark?.label ?? "";
    this.mark = mark;
    this.label.disabled = this.remove.disabled = !mark || fixed;
    this.snap.disabled = !mark || fixed;
    this.model.value = state.model;
    this.model.disabled = fixed;
    this.fit.textContent = said(state);
    this.fit.classList.toggle("warned", Boolean(state.fit?.error));
  }
}

/**
 * The fit in words.
 * @param {State} state that of the session
 * @returns {string}
 */
function said(state) {
  const { fit } = state;
  if (!fit) return "";
  if (fit.error) return fit.error;
  const um = (value) => (value === null || value === undefined ? "–" : `${value.toFixed(2)} µm`);
  const model = fit.model === state.model ? "" : `${fit.model}: `;
  const follows = fit.follows ? `; ${state.model} follows` : "";
  return `${model}${pairsOf(state).length} pairs in use, residual ${um(fit.rms_um)}, leave-one-out ${um(fit.loo_rms_um)} (rms)${follows}`;
}

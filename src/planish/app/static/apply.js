/** Apply: a new run of what was changed, its progress, and the link to its report. */

import { button, make } from "./dom.js";

/** @import {App} from "./main.js" */

const POLL_MS = 250;

/**
 * Make the button `Apply` and what belongs to it.
 * @param {HTMLElement} place element that gets them
 * @param {App} app session of this window
 */
export function mountApply(place, app) {
  const bar = make("progress", { max: 1, "aria-label": "Progress of Apply", hidden: true });
  const words = make("span", { class: "soft", id: "apply-words" });
  const apply = button("Apply", start, {
    class: "main",
    disabled: app.readOnly,
    title: "Make a new run beside this one, with all changes; this run stays as it is",
  });
  const cancel = button("Cancel", () => app.api.post("apply/cancel").then(watch, failed), { hidden: true });
  const open = button("Open the new run", () => app.api.post("apply/open").then(() => location.reload(), failed), { hidden: true });
  const link = make("a", { target: "_blank", rel: "noopener", hidden: true });
  place.replaceChildren(words, bar, link, open, cancel, apply);
  void app.api.get("apply").then((now) => (now.state === "idle" ? paint(now) : show(now)), () => {});
  // What is changed after Apply is not in the run that it made: the page says so.
  app.onState(() => open.hidden || void app.api.get("apply").then(paint, () => {}));

  /**
   * Start the work and follow it.
   * @returns {Promise<void>}
   */
  async function start() {
    app.alarm(null);
    try {
      await app.api.post("apply");
      await watch();
    } catch (error) {
      failed(error);
    }
  }

  /**
   * Say what was refused.
   * @param {any} error mostly an ApiError
   */
  function failed(error) {
    app.alarm(error.message, error.ofOtherRun);
  }

  let watching = false;
  /**
   * Ask for the progress until the work has ended.
   * @returns {Promise<void>}
   */
  async function watch() {
    if (watching) return;
    watching = true;
    try {
      for (;;) {
        const now = await app.api.get("apply").catch((error) => {
          if (error.status) throw error;
          return null; // the server is away: the page says so, and the work may still be going on
        });
        if (now) show(now);
        if (now && now.state !== "working") return;
        await new Promise((resolve) => setTimeout(resolve, POLL_MS));
      }
    } finally {
      watching = false;
    }
  }

  /**
   * Show how far it is, and say how it ended.
   * @param {any} now answer of the server
   */
  function show(now) {
    paint(now);
    if (now.state === "working") void watch();
    else if (now.state === "failed") app.alarm(now.message ?? "Apply failed.");
    else if (now.state === "cancelled") app.say("Apply was cancelled; nothing was written.");
    else if (now.state === "done") app.say(now.message || `${now.run} is ready.`);
  }

  /**
   * Show how far it is.
   * @param {any} now answer of the server
   */
  function paint(now) {
    const working = now.state === "working";
    const hadFocus = document.activeElement === cancel || document.activeElement === apply;
    bar.hidden = cancel.hidden = !working;
    apply.disabled = working || app.readOnly;
    if (typeof now.share === "number") bar.value = now.share;
    else bar.removeAttribute("value");
    const name = (now.run ?? "the new run").split(/[\\/]/).at(-1);
    words.textContent = working ? (now.stage ?? "") : "";
    if (now.state === "done") {
      const lacks = now.outdated ? ` ${name} lacks what was changed since: apply it again.` : "";
      words.textContent = `This page still shows the run before.${lacks}`;
    }
    link.hidden = !now.report;
    open.hidden = now.state !== "done";
    if (now.report) {
      link.href = now.report;
      link.textContent = `Open report of ${name}`;
    }
    if (hadFocus) (working ? cancel : now.report ? link : apply).focus();
  }
}

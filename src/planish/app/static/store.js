/** The session as this window knows it: its state, and changes that are sent one after the other. */

import { ApiError } from "./api.js";

/** Tabs whose part of the state is another one: undo and redo are the same on all of them. */
const tabsOf = (before, after) => [["marks", "Marks"], ["corrections", "Surfaces"], ["regions", "Maps"]]
  .filter(([part]) => JSON.stringify(before[part]) !== JSON.stringify(after[part])).map(([, tab]) => tab).join(", ");

export class Store {
  /** `session`: the facts of the run, which do not change */
  constructor(api, session, state, lines) {
    this.api = api;
    this.session = session;
    this.pictures = session.pictures ?? [];
    this.state = state;
    this.lines = lines;
    this.alarm = lines.alarm;
    this.did = "";
    /** Registration that is shown, by the name of its moving layer. */
    this.layer = state.layer;
    this.listeners = [];
    this.queue = Promise.resolve();
    this.counted = {};
    this.readOnly = Boolean(session.read_only);
  }

  /** Say what was done; where marks are seen, what the fit has to say of them stands behind it. */
  say(text) {
    this.did = text;
    const ofMarks = document.body.dataset.tab === "marks" ? this.state.message : "";
    this.lines.message([text, ofMarks].filter(Boolean).join(" "));
  }

  /** How the valid values of a picture are distributed; counted once. */
  histogram({ id }) {
    return (this.counted[id] ??= this.api.get(`histogram?id=${id}`));
  }

  /** Show another registration. */
  async chooseLayer(layer) {
    this.layer = layer;
    await this.refresh(true);
  }

  ofLayer(path) {
    return `${path}${path.includes("?") ? "&" : "?"}layer=${encodeURIComponent(this.layer)}`;
  }

  /** Call now and whenever the state is another. */
  onState(listener) {
    this.listeners.push(listener);
    listener(this.state);
  }

  setState(state) {
    if (state.version < this.state.version) return;
    this.state = state;
    this.say(this.did);
    for (const listener of this.listeners) listener(state);
  }

  /** Take the state from the server; `anew` also an older version, since it may have been started again. */
  async refresh(anew = false) {
    const state = await this.api.get(this.ofLayer("state"));
    if (anew) this.state = { ...this.state, version: -1 };
    this.setState(state);
  }

  /** The server has another version: it is taken, where it is not this window's own write that led to it. */
  async heard(version) {
    await this.queue;
    if (version > this.state.version) await this.refresh();
  }

  /**
   * Change the session; what is to be changed is asked when all earlier changes are done.
   * `words`: what was done, said when it is saved
   * The new state, null where it was not changed
   */
  change(change, words) {
    return this.write(() => {
      const now = typeof change === "function" ? change(this.state) : change;
      return now && this.post("change", { change: { ...now, layer: this.layer } });
    }, words);
  }

  /** Write, and get the state of the registration that is shown. */
  post(path, body = {}) {
    return this.api.post(this.ofLayer(path), body);
  }

  undo() {
    return this.state.can_undo ? this.write(() => this.post("undo"), (before, after) => `Undone in ${tabsOf(before, after)}`) : Promise.resolve(null);
  }

  redo() {
    return this.state.can_redo ? this.write(() => this.post("redo"), (before, after) => `Done again in ${tabsOf(before, after)}`) : Promise.resolve(null);
  }

  /** Send one write after all earlier ones and show what it led to. */
  write(send, words) {
    const done = this.queue.then(async () => {
      if (this.readOnly) throw new ApiError(0, "This run is open read-only: nothing can be changed.");
      const state = await send();
      if (!state) return null;
      this.alarm(null);
      const said = typeof words === "function" ? words(this.state, state) : words;
      this.setState(state);
      this.say(`${state.said ? `${said}. ${state.said}` : `${said}.`} Saved.`);
      return state;
    });
    const caught = done.catch((error) => this.refused(error));
    this.queue = caught.then(() => {});
    return caught;
  }

  /** Say why something was not done. */
  refused(error) {
    if (error.status === 409 && error.body?.version) this.setState(error.body);
    const lost = error.status === 0 && !this.readOnly;
    this.alarm(lost ? `${error.message} The change was not saved.` : error.message, error.ofOtherRun);
    for (const listener of this.listeners) listener(this.state); // a box that was ticked shows again what stands
    return null;
  }
}

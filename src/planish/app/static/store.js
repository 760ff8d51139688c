/** The session as this window knows it: its state, and changes that are sent one after the other. */

import { ApiError } from "./api.js";

/**
 * @import {Api} from "./api.js"
 * @import {Histogram} from "./contrast.js"
 * @import {Correction} from "./corrections.js"
 * @import {Point} from "./geometry.js"
 * @typedef {"moving"|"fixed"} Side
 * @typedef {string|number} MarkId
 * @typedef {{id: MarkId, label: string, used: boolean, moving: Point|null, fixed: Point|null, source: string,
 *   residual_um: number|null, leave_one_out_um: number|null, without_weight?: boolean,
 *   predicted?: {moving?: Point, fixed?: Point}, note?: string}} Mark
 * @typedef {{model: string, rms_um: number|null, loo_rms_um: number|null, follows?: boolean, error?: string,
 *   transform?: {scale: number, rotation_rad: number, shift_um: Point, mirrored: boolean}|null}} Fit
 * @typedef {{id: MarkId, name: string, author: string, reason: string, polygon: Point[]}} Region
 * @typedef {{version: number, layer: string, marks: Mark[], model: string, fit: Fit|null, message?: string,
 *   said?: string, warnings: {id?: MarkId|null, text: string}[], corrections: Correction[], regions: Region[],
 *   can_undo: boolean, can_redo: boolean}} State
 */

/**
 * Tabs whose part of the state is another one: undo and redo are the same on all of them.
 * @param {State} before the one until now
 * @param {State} after the new one
 * @returns {string}
 */
const tabsOf = (before, after) => [["marks", "Marks"], ["corrections", "Surfaces"], ["regions", "Maps"]]
  .filter(([part]) => JSON.stringify(before[part]) !== JSON.stringify(after[part])).map(([, tab]) => tab).join(", ");

export class Store {
  /**
   * Begin with a state.
   * @param {Api} api the server
   * @param {any} session facts of the run, which do not change
   * @param {State} state that of the session
   * @param {any} lines status lines of the page
   */
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

  /**
   * Say what was done; where marks are seen, what the fit has to say of them stands behind it.
   * @param {string} text what was done
   */
  say(text) {
    this.did = text;
    const ofMarks = document.body.dataset.tab === "marks" ? this.state.message : "";
    this.lines.message([text, ofMarks].filter(Boolean).join(" "));
  }

  /**
   * How the valid values of a picture are distributed; counted once.
   * @param {{id: string}} picture the picture
   * @returns {Promise<Histogram>}
   */
  histogram({ id }) {
    return (this.counted[id] ??= this.api.get(`histogram?id=${id}`));
  }

  /**
   * Show another registration.
   * @param {string} layer name of its moving layer
   * @returns {Promise<void>}
   */
  async chooseLayer(layer) {
    this.layer = layer;
    await this.refresh(true);
  }

  /**
   * A path that names the registration that is shown.
   * @param {string} path below `/api/`
   * @returns {string}
   */
  ofLayer(path) {
    return `${path}${path.includes("?") ? "&" : "?"}layer=${encodeURIComponent(this.layer)}`;
  }

  /**
   * Call now and whenever the state is another.
   * @param {(state: State) => void} listener gets the state
   */
  onState(listener) {
    this.listeners.push(listener);
    listener(this.state);
  }

  /**
   * Take a state, unless it is older than the one that there is.
   * @param {State} state the new one
   */
  setState(state) {
    if (state.version < this.state.version) return;
    this.state = state;
    this.say(this.did);
    for (const listener of this.listeners) listener(state);
  }

  /**
   * Take the state from the server.
   * @param {boolean} [anew] whether an older version is taken too, since the server may have been started again
   * @returns {Promise<void>}
   */
  async refresh(anew = false) {
    const state = await this.api.get(this.ofLayer("state"));
    if (anew) this.state = { ...this.state, version: -1 };
    this.setState(state);
  }

  /**
   * The server has another version: it is taken, where it is not this window's own write that led to it.
   * @param {number} version that of the server
   * @returns {Promise<void>}
   */
  async heard(version) {
    await this.queue;
    if (version > this.state.version) await this.refresh();
  }

  /**
   * Change the session; what is to be changed is asked when all earlier changes are done.
   * @param {object|((state: State) => object|null)} change what is changed; null changes nothing
   * @param {string} words what was done, said when it is saved
   * @returns {Promise<State|null>} the new state, null where it was not changed
   */
  change(change, words) {
    return this.write(() => {
      const now = typeof change === "function" ? change(this.state) : change;
      return now && this.post("change", { change: { ...now, layer: this.layer } });
    }, words);
  }

  /**
   * Write, and get the state of the registration that is shown.
   * @param {string} path below `/api/`
   * @param {object} [body] what is sent
   * @returns {Promise<State>}
   */
  post(path, body = {}) {
    return this.api.post(this.ofLayer(path), body);
  }

  /**
   * Take the last change back.
   * @returns {Promise<State|null>} null where there is none
   */
  undo() {
    return this.state.can_undo ? this.write(() => this.post("undo"), (before, after) => `Undone in ${tabsOf(before, after)}`) : Promise.resolve(null);
  }

  /**
   * Make the change again that was taken back.
   * @returns {Promise<State|null>} null where there is none
   */
  redo() {
    return this.state.can_redo ? this.write(() => this.post("redo"), (before, after) => `Done again in ${tabsOf(before, after)}`) : Promise.resolve(null);
  }

  /**
   * Send one write after all earlier ones and show what it led to.
   * @param {() => Promise<State|null>} send sends it; null where nothing was to be written
   * @param {string|((before: State, after: State) => string)} words what was done
   * @returns {Promise<State|null>} the new state, null where nothing was written
   */
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

  /**
   * Say why something was not done.
   * @param {any} error mostly an ApiError
   * @returns {null}
   */
  refused(error) {
    if (error.status === 409 && error.body?.version) this.setState(error.body);
    const lost = error.status === 0 && !this.readOnly;
    this.alarm(lost ? `${error.message} The change was not saved.` : error.message, error.ofOtherRun);
    for (const listener of this.listeners) listener(this.state); // a box that was ticked shows again what stands
    return null;
  }
}

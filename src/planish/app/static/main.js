/** Start of the page: token, session, tabs, status lines, undo and redo, and what happens when the server is lost. */

import { Api, takeToken } from "./api.js";
import { mountApply } from "./apply.js";
import { button, typeset } from "./dom.js";
import { Store } from "./store.js";

/**
 * @typedef {Store & {cursor: (text: string) => void, predicted: (text: string) => void,
 *   slicePosition: (text: string) => void, openTab: (name: string) => Promise<void>,
 *   onTab: (listener: (name: string) => void) => void,
 *   showSlice?: (x_um: number, y_um: number, z_um?: number, layer?: string) => Promise<void>,
 *   news?: (line: any) => void}} App what the tabs share: the session, and the page around them
 */

/** Modules of the tabs; each exports `mount(panel, app)`, called when its tab is first opened. */
const TABS = {
  marks: () => import("./marks.js"),
  surfaces: () => import("./surfaces.js"),
  maps: () => import("./maps.js"),
  flattening: () => import("./flattening.js"),
};

/**
 * An element of the page.
 * @param {string} id its id
 * @returns {any}
 */
const find = (id) => document.getElementById(id);

const lines = {
  message: setter("message"),
  cursor: setter("cursor"),
  predicted: setter("predicted"),
  slicePosition: setter("slice"),
  /** `reload`: whether a button beside the text loads the page again */
  alarm: (text, reload = false) => {
    const place = find("alarm");
    const words = typeset(text ?? "");
    const again = reload ? [" ", button("Reload the page", () => location.reload())] : [];
    if (reload || place.textContent !== words) place.replaceChildren(words, ...again);
    place.hidden = !text;
  },
};

/**
 * What writes a status line.
 * @param {string} name that of the line
 * @returns {(text: string) => void}
 */
function setter(name) {
  const line = find(`line-${name}`);
  return (text) => {
    if (line.textContent !== typeset(text)) line.textContent = typeset(text);
  };
}

/**
 * Open the page on a session.
 * @returns {Promise<void>}
 */
async function start() {
  const token = takeToken();
  if (!token) {
    lines.alarm("Open this page with the whole address that 'planish view' printed: it ends with a token.");
    return;
  }
  const api = new Api(token);
  let session, state;
  try {
    [session, state] = await Promise.all([api.get("session"), api.get("state")]);
  } catch (error) {
    lines.alarm(
      error.status === 401
        ? "The token of this page is not that of the server. Open the address that 'planish view' printed."
        : `${error.message} Start 'planish view' again and open the address that it prints.`,
    );
    return;
  }
  api.run = session.run;
  const { cursor, predicted, slicePosition } = lines;
  const extras = { cursor, predicted, slicePosition, openTab, onTab };
  const app = Object.assign(new Store(api, session, state, lines), extras);
  nameRun(session);
  app.say(session.read_only ? `Open read-only. ${session.reason}` : session.said);
  bindHistory(app);
  mountTabs(app);
  bindHelp();
  mountApply(find("apply"), app);
  void followServer(api, app);
}

/**
 * Write the name of the run into the page and its title.
 * @param {any} session facts of the run
 */
function nameRun(session) {
  const name = session.title ?? session.name ?? session.run ?? "";
  find("run-name").textContent = name;
  find("run-name").title = name;
  document.title = `${name} – planish`;
  if (session.read_only) {
    find("run-name").textContent = `${name} (read only)`;
    find("run-name").title = session.reason;
  }
}

/**
 * Let buttons and keys undo and redo.
 * @param {App} app session of this window
 */
function bindHistory(app) {
  find("undo").addEventListener("click", () => app.undo());
  find("redo").addEventListener("click", () => app.redo());
  app.onState((state) => {
    find("undo").disabled = !state.can_undo || app.readOnly;
    find("redo").disabled = !state.can_redo || app.readOnly;
  });
  document.addEventListener("keydown", (event) => {
    if (!(event.ctrlKey || event.metaKey) || event.altKey || isText(event.target)) return;
    const key = event.key.toLowerCase();
    if (key !== "z" && key !== "y") return;
    event.preventDefault();
    if (key === "y" || event.shiftKey) app.redo();
    else app.undo();
  });
}

/**
 * Whether a key belongs to the text that is being written.
 * @param {EventTarget|null} target element that has the focus
 * @returns {boolean}
 */
const isText = (target) => target instanceof HTMLElement && target.matches("textarea, input:not([type=checkbox], [type=range])");

/** The list of keys is opened by its button or by the key ?, and closed by Esc. */
function bindHelp() {
  find("help").addEventListener("click", () => find("keys").showModal());
  document.addEventListener("keydown", (event) => {
    if (event.key === "?" && !isText(event.target) && !find("keys").open) find("keys").showModal();
  });
}

// --- tabs --------------------------------------------------------------------------------------------------------

const opened = new Map();
const tabListeners = [];
let shared = null;

/**
 * Call with the tab's name whenever a tab is shown.
 * @param {(name: string) => void} listener gets the name
 */
function onTab(listener) {
  tabListeners.push(listener);
}

/**
 * Let buttons and keys choose a tab, and open the first one.
 * @param {App} app session of this window
 */
function mountTabs(app) {
  shared = app;
  onTab(() => app.say(app.did));
  const tabs = [.../** @type {NodeListOf<HTMLButtonElement>} */ (document.querySelectorAll("[role=tab]"))];
  tabs.forEach((tab, i) => {
    tab.disabled = false; // until now a click would have been lost
    tab.addEventListener("click", () => openTab(nameOf(tab)));
    tab.addEventListener("keydown", (event) => {
      const step = { ArrowRight: 1, ArrowLeft: -1, Home: -i, End: tabs.length - 1 - i }[event.key];
      if (step === undefined) return;
      event.preventDefault();
      const next = tabs[(i + step + tabs.length) % tabs.length];
      next.focus();
      void openTab(nameOf(next));
    });
  });
  void openTab("marks");
}

/**
 * The name of a tab.
 * @param {Element} tab its button
 * @returns {string}
 */
const nameOf = (tab) => tab.id.replace("tab-", "");

/**
 * Show a tab, and make it when it is opened for the first time.
 * @param {string} name a key of `TABS`
 * @returns {Promise<void>}
 */
function openTab(name) {
  for (const tab of /** @type {NodeListOf<HTMLElement>} */ (document.querySelectorAll("[role=tab]"))) {
    const chosen = nameOf(tab) === name;
    tab.setAttribute("aria-selected", String(chosen));
    tab.tabIndex = chosen ? 0 : -1;
    find(`panel-${nameOf(tab)}`).hidden = !chosen;
  }
  for (const line of /** @type {NodeListOf<HTMLElement>} */ (document.querySelectorAll("[data-tabs]"))) {
    line.hidden = !(line.dataset.tabs ?? "").split(" ").includes(name);
  }
  document.body.dataset.tab = name;
  if (!opened.has(name)) opened.set(name, mountTab(name));
  for (const listener of tabListeners) listener(name);
  return opened.get(name);
}

/**
 * Fill a tab.
 * @param {string} name a key of `TABS`
 * @returns {Promise<void>}
 */
async function mountTab(name) {
  const panel = find(`panel-${name}`);
  try {
    const module = await TABS[(name)]();
    await module.mount(panel, shared);
  } catch (error) {
    opened.delete(name);
    lines.alarm("This tab could not be opened. Reload the page; if that does not help, start 'planish view' again.");
    throw error;
  }
}

// --- the server's news -------------------------------------------------------------------------------------------

const LOST = "No connection to planish. Nothing is saved until it is back; start 'planish view' again if it was ended.";
const ANEW = "This page lost its connection: planish was started anew. Open the address that it printed.";

/**
 * Follow the changes of other windows, and say when the server is lost and found.
 * @param {Api} api the server
 * @param {App} app session of this window
 * @returns {Promise<never>}
 */
function followServer(api, app) {
  let lost = false;
  return api.follow({
    onNews: (line) => {
      if (line.run && line.run !== app.session.run) return location.reload(); // another run is served now
      void app.heard(line.version).catch(() => {});
      app.news?.(line);
    },
    onLost: (status) => {
      lost = true;
      app.alarm(status === 401 ? ANEW : LOST);
    },
    onFound: async () => {
      await app.refresh(true);
      if (lost) {
        app.alarm(null);
        app.say("The connection is back.");
      }
      lost = false;
    },
  });
}

window.addEventListener("hashchange", () => location.hash.includes("token=") && location.reload());
void start();

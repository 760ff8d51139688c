/** Marks from and to files of planish and other programs. */

import { button, choice, download, labelled, make } from "./dom.js";

/** @import {App} from "./main.js" */

/** Files of these suffixes are no text. */
const BINARY = /\.(mat|roi|zip)$/i;
/** Of two files, that of the Image side. */
const FIXED = /fixed|target|image/i;
const MOST_BYTES = 1_400_000;

/**
 * Buttons `Import marks` and `Export marks`.
 * @param {App} app session of this window
 * @returns {HTMLElement}
 */
export function exchange(app) {
  const chosen = make("input", { type: "file", multiple: true, hidden: true, "aria-label": "File of marks", onchange: take });
  const formats = (app.session.export_formats ?? ["json"]).map((one) =>
    typeof one === "string" ? one : [one.name, one.title],
  );
  const format = choice(formats, () => {});
  format.value = "json";
  return make(
    "div",
    { class: "group" },
    button("Import marks", () => chosen.click(), { disabled: app.readOnly, title: "Replaces all marks; one undo step" }),
    chosen,
    labelled("", format, "Format"),
    button("Export marks", give),
  );

  /**
   * Send the files that a person chose.
   * @returns {Promise<void>}
   */
  async function take() {
    const files = [...(chosen.files ?? [])].sort((a, b) => Number(FIXED.test(a.name)) - Number(FIXED.test(b.name)));
    chosen.value = "";
    if (!files.length) return;
    const size = files.reduce((sum, file) => sum + file.size, 0);
    if (files.length > 2 || size > MOST_BYTES) {
      app.alarm(`${files.length} files with ${size} bytes; marks come in one or two files, ${MOST_BYTES} bytes at most.`);
      return;
    }
    const [first, second] = await Promise.all(files.map(content));
    const words = second ? `Volume side from ${first.name}, Image side from ${second.name}` : `Marks of ${first.name}`;
    const body = { ...first, second, layer: app.layer };
    await app.write(() => app.post("marks/import", body), `${words} in place of all others`);
  }

  /**
   * Have the browser save the marks in the format of the box.
   * @returns {Promise<void>}
   */
  async function give() {
    try {
      const response = await app.api.fetch(app.ofLayer(`marks/export?format=${encodeURIComponent(format.value)}`));
      const said = /filename="([^"]+)"/.exec(response.headers.get("content-disposition") ?? "");
      const name = said?.[1] ?? "marks.json";
      download(await response.blob(), name);
      app.say(`Exported ${name}.`);
    } catch (error) {
      app.alarm(error.message);
    }
  }
}

/**
 * What is sent of a file: its name, and its text or its bytes.
 * @param {File} file chosen by a person
 * @returns {Promise<{name: string, text?: string, base64?: string}>}
 */
const content = async (file) =>
  BINARY.test(file.name)
    ? { name: file.name, base64: await encoded(file) }
    : { name: file.name, text: await file.text() };

/**
 * The bytes of a file in base64.
 * @param {File} file chosen by a person
 * @returns {Promise<string>}
 */
async function encoded(file) {
  const bytes = new Uint8Array(await file.arrayBuffer());
  let text = "";
  for (let at = 0; at < bytes.length; at += 0x8000) text += String.fromCharCode(...bytes.subarray(at, at + 0x8000));
  return btoa(text);
}

/** Marks from and to files of planish and other programs. */

import { button, choice, labelled, make } from "./dom.js";

/** Files of these suffixes are no text. */
const BINARY = /\.mat$/i;
const MOST_BYTES = 1_400_000;

/**
 * Buttons `Import marks` and `Export marks`.
 * @param {any} app
 * @returns {HTMLElement}
 */
export function exchange(app) {
  const chosen = make("input", { type: "file", hidden: true, onchange: take });
  const formats = (app.session.export_formats ?? ["json"]).map((/** @type {any} */ one) =>
    typeof one === "string" ? one : [one.name, one.title],
  );
  const format = choice(formats, () => {});
  return make(
    "div",
    { class: "group" },
    button("Import marks", () => chosen.click(), { disabled: app.readOnly, title: "Replaces all marks; one undo step" }),
    chosen,
    labelled("Format", format),
    button("Export marks", give),
  );

  async function take() {
    const file = chosen.files?.[0];
    chosen.value = "";
    if (!file) return;
    if (file.size > MOST_BYTES) {
      app.alarm(`${file.name} has ${file.size} bytes; a file of marks has ${MOST_BYTES} at most.`);
      return;
    }
    const body = BINARY.test(file.name)
      ? { name: file.name, base64: await encoded(file) }
      : { name: file.name, text: await file.text() };
    await app.write(() => app.api.post("marks/import", body), `Marks of ${file.name} in place of all others`);
  }

  async function give() {
    try {
      const response = await app.api.fetch(`marks/export?format=${encodeURIComponent(format.value)}`);
      const said = /filename="([^"]+)"/.exec(response.headers.get("content-disposition") ?? "");
      const address = URL.createObjectURL(await response.blob());
      const link = make("a", { href: address, download: said?.[1] ?? "marks.json" });
      link.click();
      setTimeout(() => URL.revokeObjectURL(address), 10_000);
      app.say(`Exported ${link.download}.`);
    } catch (/** @type {any} */ error) {
      app.alarm(error.message);
    }
  }
}

/** @param {File} file @returns {Promise<string>} */
async function encoded(file) {
  const bytes = new Uint8Array(await file.arrayBuffer());
  let text = "";
  for (let at = 0; at < bytes.length; at += 0x8000) text += String.fromCharCode(...bytes.subarray(at, at + 0x8000));
  return btoa(text);
}

/** Elements of the page, made in one expression. */

/**
 * Make an element. Attributes that are `false` or `null` are left out; `on…` are listeners; text is never read as HTML.
 * @param {string} tag name of the element
 * @param {Record<string, any>} [attributes] by name
 * @param {...(Node|string|null)} children what it holds; null is left out
 * @returns {any} the element
 */
export function make(tag, attributes = {}, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(attributes)) {
    if (value === null || value === false || value === undefined) continue;
    if (name.startsWith("on")) element.addEventListener(name.slice(2), value);
    else element.setAttribute(name, value === true ? "" : String(value));
  }
  element.append(...children.filter((child) => child !== null));
  return element;
}

/**
 * A button with a name and what it does.
 * @param {string} name what stands on it
 * @param {(event: Event) => void} act called by a click
 * @param {Record<string, any>} [attributes] others, by name
 * @returns {HTMLButtonElement}
 */
export const button = (name, act, attributes = {}) =>
  make("button", { type: "button", onclick: act, ...attributes }, name);

let fields = 0;

/**
 * A field or box beside its label.
 * @param {string} label name for scripts and readers
 * @param {HTMLElement} field what is labelled
 * @param {string} [unseen] what stands before the label for those who do not see where the field is
 * @param {string} [seen] what is read, where that is another
 * @returns {HTMLElement}
 */
export function labelled(label, field, unseen = "", seen = typeset(label)) {
  field.id ||= `field-${++fields}`;
  if (seen !== label) field.setAttribute("aria-label", unseen + label); // as scripts know it
  const name = make("label", { for: field.id }, make("span", { class: "sr" }, unseen), seen);
  return make("span", { class: "field" }, name, field);
}

/**
 * Write um and deg as they are read.
 * @param {string} text with ASCII units
 * @returns {string}
 */
export const typeset = (text) => text.replaceAll(/\bum\b/g, "µm").replaceAll(/ ?\bdeg\b/g, "°");

/**
 * A number as it is read.
 * @param {number|null} value null is missing
 * @returns {string}
 */
export const shown = (value) => (value === null ? "no value" : String(Number(value.toPrecision(5))));

/**
 * What stands behind a number; nothing where it has no unit.
 * @param {object} values what the number is of
 * @param {string} values.units ASCII
 * @returns {string}
 */
export const withUnit = ({ units }) => (units && units !== "1" ? typeset(` ${units}`).replace(" °", "°") : "");

/**
 * Have the browser save a file.
 * @param {Blob} blob its bytes
 * @param {string} name its name
 */
export function download(blob, name) {
  const address = URL.createObjectURL(blob);
  make("a", { href: address, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(address), 10_000);
}

/**
 * A box of choices; each is `value` or `[value, words]`.
 * @param {(string|string[])[]} choices in their order
 * @param {(value: string) => void} onChange called with the new choice
 * @returns {HTMLSelectElement}
 */
export function choice(choices, onChange) {
  const box = make("select", { onchange: () => onChange(box.value) });
  for (const one of choices) {
    const [value, words] = Array.isArray(one) ? one : [one, one];
    box.append(make("option", { value }, words));
  }
  return box;
}

/**
 * Write a position, two decimals, without digit grouping.
 * @param {number[]} point its coordinates
 * @returns {string}
 */
export const written = (point) => point.map((value) => value.toFixed(2)).join(", ");

/**
 * Read "x, y" or any number of values apart by commas, semicolons or spaces.
 * @param {string} text as a person wrote it
 * @param {number} count how many there have to be
 * @returns {number[]|null} null where they are not so many numbers
 */
export function numbers(text, count) {
  const values = text.trim().replaceAll("−", "-").split(/[\s,;]+/).map((word) => (word === "" ? NaN : Number(word)));
  return values.length === count && values.every(Number.isFinite) ? values : null;
}

/**
 * Take what is written into a field of numbers.
 * @param {HTMLInputElement} field the field
 * @param {object} take what is done with it
 * @param {number} take.count how many numbers there have to be
 * @param {(found: number[]|null) => void} take.use gets them, or null where the field is empty and may be
 * @param {() => void} take.refuse called with anything else
 * @param {boolean} [take.empty] whether the field may be empty
 * @param {(found: number[]) => boolean} [take.valid] tells whether the numbers fit
 */
export function onNumbers(field, { count, use, refuse, empty = true, valid = () => true }) {
  field.addEventListener("change", () => {
    const found = numbers(field.value, count);
    const fits = found ? valid(found) : empty && !field.value.trim();
    field.setAttribute("aria-invalid", String(!fits));
    if (fits) use(found);
    else refuse();
  });
}

/**
 * Read a number above 0.
 * @param {string} text as a person wrote it
 * @returns {number[]|null} the number alone
 */
export function positive(text) {
  const values = numbers(text, 1);
  return values && values[0] > 0 ? values : null;
}

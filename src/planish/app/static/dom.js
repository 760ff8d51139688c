/** Elements of the page, made in one expression. */

/**
 * Make an element. Attributes that are `false` or `null` are left out; `on…` are listeners; text is never read as HTML.
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

/** A button with a name and what it does. */
export const button = (name, act, attributes = {}) =>
  make("button", { type: "button", onclick: act, ...attributes }, name);

let fields = 0;

/**
 * A field or box beside its label.
 * `unseen`: what stands before the label for those who do not see where the field is
 * `seen`: what is read, where that is another
 */
export function labelled(label, field, unseen = "", seen = typeset(label)) {
  field.id ||= `field-${++fields}`;
  if (seen !== label) field.setAttribute("aria-label", unseen + label); // as scripts know it
  const name = make("label", { for: field.id }, make("span", { class: "sr" }, unseen), seen);
  return make("span", { class: "field" }, name, field);
}

/** Write um and deg as they are read. */
export const typeset = (text) => text.replaceAll(/\bum\b/g, "µm").replaceAll(/ ?\bdeg\b/g, "°");

/** A number as it is read. */
export const shown = (value) => (value === null ? "no value" : String(Number(value.toPrecision(5))));

/** What stands behind a number; nothing where it has no unit. */
export const withUnit = ({ units }) => (units && units !== "1" ? typeset(` ${units}`).replace(" °", "°") : "");

/** Have the browser save a file. */
export function download(blob, name) {
  const address = URL.createObjectURL(blob);
  make("a", { href: address, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(address), 10_000);
}

/** A box of choices; each is `value` or `[value, words]`. */
export function choice(choices, onChange) {
  const box = make("select", { onchange: () => onChange(box.value) });
  for (const one of choices) {
    const [value, words] = Array.isArray(one) ? one : [one, one];
    box.append(make("option", { value }, words));
  }
  return box;
}

/** Write a position, two decimals, without digit grouping. */
export const written = (point) => point.map((value) => value.toFixed(2)).join(", ");

/** Read "x, y" or any number of values apart by commas, semicolons or spaces. */
export function numbers(text, count) {
  const values = text.trim().replaceAll("−", "-").split(/[\s,;]+/).map((word) => (word === "" ? NaN : Number(word)));
  return values.length === count && values.every(Number.isFinite) ? values : null;
}

/**
 * Take what is written into a field of numbers: `use` gets them, or null where the field is empty and may be; else
 * `refuse` is called.
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

/** Read a number above 0. */
export function positive(text) {
  const values = numbers(text, 1);
  return values && values[0] > 0 ? values : null;
}

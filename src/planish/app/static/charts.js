/** Values of maps along a line. */

import { button, make, shown } from "./dom.js";
import { ticks } from "./scatter.js";
import { SVG, viewBar } from "./viewbar.js";

const [WIDE, TALL, LEFT, TOP] = [380, 190, 60, 22];
const INKS = ["var(--mark, #24597f)", "var(--bad, #a5301d)"];
const INK = "var(--ink, #22292f)";

/**
 * Make an element of an SVG.
 * @param {string} tag its name
 * @param {Record<string, string|number>} attributes written as they are
 * @param {...(Node|string)} children what it holds
 * @returns {Element}
 */
function draw(tag, attributes, ...children) {
  const element = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, String(value));
  element.append(...children);
  return element;
}

/**
 * Words in an SVG.
 * @param {number} x place to the right
 * @param {number} y place of the base line, down
 * @param {string} words what is written
 * @param {"start"|"middle"|"end"} anchor part of the words that lies at x
 * @param {string} [fill] colour
 * @returns {Element}
 */
const text = (x, y, words, anchor, fill = INK) => draw("text", { x, y, "text-anchor": anchor, fill }, words);

/**
 * Draw the values along a line, one curve a layer, each on its own scale.
 * @param {object} found answer of the server
 * @param {number[]} found.at_um distances along the line
 * @param {number} found.pixel_um pitch of the maps
 * @param {{name: string, values: (number|null)[]}[]} found.lines values of both layers
 * @param {string[]} titles names of both layers as they are read
 * @param {() => void} close called by the button that closes it
 * @returns {HTMLElement}
 */
export function profile(found, titles, close) {
  const length = found.at_um.at(-1);
  const [wide, tall] = [WIDE + 2 * LEFT, TOP + TALL + 36];
  const svg = draw("svg", { xmlns: SVG, viewBox: `0 0 ${wide} ${tall}`, "aria-hidden": "true", "font-family": "sans-serif", "font-size": 12 });
  svg.append(draw("rect", { x: LEFT, y: TOP, width: WIDE, height: TALL, fill: "none", stroke: "#7d8891" }));
  for (const tick of ticks(0, length, 8)) svg.append(text(LEFT + (tick / length) * WIDE, TOP + TALL + 16, String(tick), "middle"));
  svg.append(text(LEFT + WIDE / 2, TOP + TALL + 31, `Distance along the line, µm (${shown(length)} in all)`, "middle"));
  found.lines.forEach((line, k) => {
    svg.append(text(k ? LEFT + WIDE : LEFT, 14, titles[k], k ? "end" : "start", INKS[k]));
    const known = line.values.filter((value) => value !== null);
    if (!known.length) return;
    const low = known.reduce((a, b) => Math.min(a, b));
    const high = Math.max(known.reduce((a, b) => Math.max(a, b)), low + 1e-12);
    const place = (value) => TOP + TALL - ((value - low) / (high - low)) * TALL;
    let pen = "M";
    const path = line.values.map((value, i) => {
      const move = pen;
      pen = value === null ? "M" : "L";
      return value === null ? "" : `${move}${(LEFT + (found.at_um[i] / length) * WIDE).toFixed(1)} ${place(value).toFixed(1)}`;
    });
    svg.append(draw("path", { d: path.join(""), fill: "none", "stroke-width": 1.3, stroke: INKS[k] }));
    for (const tick of ticks(low, high, 4)) {
      svg.append(text(k ? LEFT + WIDE + 5 : LEFT - 5, place(tick) + 4, String(tick), k ? "start" : "end", INKS[k]));
    }
  });
  const names = found.lines.map((one) => one.name).join(" and ");
  const saved = () => {
    const copy = /** @type {Element} */ (svg.cloneNode(true));
    copy.setAttribute("width", String(wide));
    copy.setAttribute("height", String(tall));
    copy.prepend(draw("rect", { width: "100%", height: "100%", fill: "#fff" }));
    return new XMLSerializer().serializeToString(copy).replaceAll(/var\(--\w+, (#\w+)\)/g, "$1"); // other programs know no variables
  };
  const bar = viewBar("Profile", { svg: saved });
  bar.append(button("×", close, { "aria-label": "Profile: close", title: "close" }));
  const picture = make("div", { role: "img", "aria-label": `Profile over ${shown(length)} um of ${names}` }, svg);
  const pixels = make("p", { class: "soft" }, `Pixels of ${shown(found.pixel_um)} µm.`);
  return make("div", { class: "profile" }, make("div", { class: "head" }, make("h2", {}, "Profile"), bar), picture, pixels);
}

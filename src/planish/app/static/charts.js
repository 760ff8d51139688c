/** Small charts of the maps: the histogram of a layer, and values along a line. */

import { make } from "./dom.js";
import { ticks } from "./scatter.js";

const SVG = "http://www.w3.org/2000/svg";

/** @param {string} tag @param {Record<string, unknown>} attributes @param {...(Node|string)} children */
function draw(tag, attributes, ...children) {
  const element = document.createElementNS(SVG, tag);
  for (const [name, value] of Object.entries(attributes)) element.setAttribute(name, String(value));
  element.append(...children);
  return element;
}

/** A number as it is read. @param {number|null} value */
export const shown = (value) => (value === null ? "no value" : String(Number(value.toPrecision(5))));

/**
 * A histogram, with the colour range that its map has.
 * @param {any} found of the server
 * @param {{name: string, units: string}} picture
 * @param {number[]} range
 */
export function histogram(found, picture, [low, high]) {
  const [width, height] = [300, 46];
  const most = Math.max(1, ...found.counts);
  const step = width / found.counts.length;
  const bars = found.counts.map((/** @type {number} */ count, /** @type {number} */ k) => {
    const tall = (height * count) / most;
    return `M${(k * step).toFixed(2)} ${height}v${(-tall).toFixed(2)}h${step.toFixed(2)}v${tall.toFixed(2)}z`;
  });
  const at = (/** @type {number} */ value) => ((value - found.low) / (found.high - found.low || 1)) * width;
  const limits = [low, high].map((value) => draw("line", { x1: at(value), x2: at(value), y1: 0, y2: height, class: "limit" }));
  const svg = draw("svg", { viewBox: `0 0 ${width} ${height}`, preserveAspectRatio: "none", "aria-hidden": "true" });
  svg.append(draw("path", { d: bars.join(""), class: "bars" }), ...limits);
  const units = picture.units && picture.units !== "1" ? ` ${picture.units}` : "";
  const beyond = found.beyond ? `, ${found.beyond} beyond` : "";
  const words =
    `n ${found.n}${beyond}; mean ${shown(found.mean)}, SD ${shown(found.sd)}, median ${shown(found.median)}${units}; ` +
    `pixels of ${shown(found.pixel_um[1])} um`;
  return make(
    "div",
    { class: "histogram", role: "img", "aria-label": `Histogram of ${picture.name}: ${words}` },
    svg,
    make("div", { class: "ends", "aria-hidden": "true" }, make("span", {}, shown(found.low)), make("span", {}, shown(found.high))),
    make("p", { class: "soft" }, words),
  );
}

/**
 * Values along a line, one curve a layer, each on its own scale.
 * @param {any} found of the server
 */
export function profile(found) {
  const [width, height, left] = [640, 130, 52];
  const length = found.at_um.at(-1);
  const svg = draw("svg", { viewBox: `0 0 ${width + 2 * left} ${height + 30}`, "aria-hidden": "true" });
  svg.append(draw("rect", { x: left, y: 4, width, height, class: "frame" }));
  for (const tick of ticks(0, length, 8)) {
    svg.append(draw("text", { x: left + (tick / length) * width, y: height + 18, class: "middle" }, String(tick)));
  }
  svg.append(draw("text", { x: left + width / 2, y: height + 30, class: "middle" }, "um along the line"));
  found.lines.forEach((/** @type {any} */ line, /** @type {number} */ k) => {
    const known = line.values.filter((/** @type {number|null} */ value) => value !== null);
    if (!known.length) return;
    const low = known.reduce((/** @type {number} */ a, /** @type {number} */ b) => Math.min(a, b));
    const high = Math.max(known.reduce((/** @type {number} */ a, /** @type {number} */ b) => Math.max(a, b)), low + 1e-12);
    const place = (/** @type {number} */ value) => 4 + height - ((value - low) / (high - low)) * height;
    let pen = "M";
    const path = line.values.map((/** @type {number|null} */ value, /** @type {number} */ i) => {
      const move = pen;
      pen = value === null ? "M" : "L";
      return value === null ? "" : `${move}${(left + (found.at_um[i] / length) * width).toFixed(1)} ${place(value).toFixed(1)}`;
    });
    svg.append(draw("path", { d: path.join(""), class: `curve curve-${k}` }));
    for (const tick of ticks(low, high, 4)) {
      const x = k ? left + width + 5 : left - 5;
      svg.append(draw("text", { x, y: place(tick) + 4, class: k ? `start text-${k}` : `end text-${k}` }, String(tick)));
    }
  });
  const key = found.lines.map((/** @type {any} */ line, /** @type {number} */ k) =>
    make("span", { class: `key text-${k}` }, `${k ? "right" : "left"} axis: ${line.name}${line.units && line.units !== "1" ? `, ${line.units}` : ""}`),
  );
  const label = `Profile over ${shown(length)} um of ${found.lines.map((/** @type {any} */ one) => one.name).join(" and ")}`;
  return make(
    "div",
    { class: "profile", role: "img", "aria-label": label },
    svg,
    make("p", { class: "soft" }, ...key, ` pixels of ${shown(found.pixel_um)} um`),
  );
}

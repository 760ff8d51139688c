/** What each view has in its corner: + - Fit, and its picture as a file. */

import { button, download, make } from "./dom.js";

/** @import {Shade} from "./colour.js" */

/** Put together here: a page that may ask no server for anything holds no address. */
export const SVG = ["http:", "", "www.w3.org", "2000", "svg"].join("/");
/** Rows of a saved picture for its names and its colour bar, in pixels. */
const FOOT = 44;

/**
 * The buttons of a view.
 * @param {string} name that of the view
 * @param {object} view what they do; without `zoom` and `fit`, only files are offered
 * @param {(factor: number) => void} [view.zoom] comes closer where the factor is above 1
 * @param {() => void} [view.fit] shows all
 * @param {() => string} view.svg gives the picture
 * @returns {HTMLElement}
 */
export function viewBar(name, view) {
  const file = name.toLowerCase().replaceAll(/[^a-z0-9]+/g, "-");
  const act = (sign, words, does) =>
    button(sign, does, { "aria-label": `${name}: ${words}`, title: words });
  const { zoom, fit } = view;
  const moves = zoom && fit ? [act("+", "zoom in", () => zoom(Math.SQRT2)), act("−", "zoom out", () => zoom(Math.SQRT1_2)), act("Fit", "show all", fit)] : [];
  return make(
    "div",
    { class: "viewbar", role: "group", "aria-label": `${name}: tools` },
    ...moves,
    act("PNG", "save as PNG", () => void savePng(view.svg(), `${file}.png`)),
    act("SVG", "save as SVG", () => download(new Blob([view.svg()], { type: "image/svg+xml" }), `${file}.svg`)),
  );
}

/**
 * Save an SVG as PNG, at twice its size.
 * @param {string} svg the picture
 * @param {string} name that of the file
 * @returns {Promise<void>}
 */
async function savePng(svg, name) {
  const address = URL.createObjectURL(new Blob([svg], { type: "image/svg+xml" }));
  const image = new Image();
  image.src = address;
  await image.decode();
  const canvas = make("canvas", { width: 2 * image.width, height: 2 * image.height });
  canvas.getContext("2d").drawImage(image, 0, 0, canvas.width, canvas.height);
  URL.revokeObjectURL(address);
  canvas.toBlob((blob) => blob && download(blob, name), "image/png");
}

/**
 * A text that an SVG takes as it is.
 * @param {string} text any
 * @returns {string}
 */
const escaped = (text) => text.replaceAll("&", "&amp;").replaceAll("<", "&lt;").replaceAll('"', "&quot;");

/**
 * A picture with what it shows below it, its colour bar and its scale bar, as SVG.
 * @param {HTMLCanvasElement} canvas the picture
 * @param {object} parts what belongs to it
 * @param {number} parts.wide width on the screen
 * @param {number} parts.tall height on the screen
 * @param {string} parts.title what it shows
 * @param {{px: number, words: string}} [parts.bar] scale bar
 * @param {{shade: Shade, limits: number[], words: string[]}} [parts.colours] colour bar
 * @returns {string}
 */
export function svgOf(canvas, { wide, tall, title, bar, colours }) {
  const text = (x, y, words, anchor = "start", fill = "#111") =>
    `<text x="${x}" y="${y}" text-anchor="${anchor}" fill="${fill}">${escaped(words)}</text>`;
  const parts = [
    `<svg xmlns="${SVG}" width="${wide}" height="${tall + FOOT}" viewBox="0 0 ${wide} ${tall + FOOT}" font-family="sans-serif" font-size="12">`,
    `<rect width="${wide}" height="${tall + FOOT}" fill="#fff"/>`,
    `<image width="${wide}" height="${tall}" href="${canvas.toDataURL("image/png")}"/>`,
    text(6, tall + 16, title),
  ];
  if (bar) {
    parts.push(`<path d="M10 ${tall - 26}v14h${bar.px}v-14" fill="none" stroke="#000" stroke-width="4"/>`);
    parts.push(`<path d="M10 ${tall - 26}v14h${bar.px}v-14" fill="none" stroke="#fff" stroke-width="2"/>`);
    parts.push(`<g paint-order="stroke" stroke="#000" stroke-width="3">${text(10 + bar.px / 2, tall - 17, bar.words, "middle", "#fff")}</g>`);
  }
  if (colours) {
    const steps = 64;
    const [left, width] = [90, Math.max(wide - 180, 40)];
    for (let k = 0; k < steps; k++) {
      const fill = colours.shade((k + 0.5) / steps).map(Math.round).join();
      parts.push(`<rect x="${left + (k * width) / steps}" y="${tall + 24}" width="${width / steps + 0.5}" height="12" fill="rgb(${fill})"/>`);
    }
    parts.push(text(left - 6, tall + 34, colours.words[0], "end"), text(left + width + 6, tall + 34, colours.words[1]));
  }
  return `${parts.join("\n")}\n</svg>\n`;
}

/**
 * A round length below the longest that a scale bar may have.
 * @param {number} longest in um
 * @returns {number} in um
 */
export function roundLength(longest) {
  const power = 10 ** Math.floor(Math.log10(longest));
  return power * ([5, 2].find((step) => step * power <= longest) ?? 1);
}

/**
 * A length as it is read.
 * @param {number} um the length
 * @returns {string}
 */
export const lengthWords = (um) => (um >= 1000 ? `${um / 1000} mm` : `${Number(um.toPrecision(2))} µm`);

/**
 * Draw a scale bar on a canvas, from its lower left end.
 * @param {CanvasRenderingContext2D} pen of the canvas
 * @param {number} x left end, in screen pixels
 * @param {number} y lower end, in screen pixels
 * @param {number} most screen pixels that it has at most
 * @param {number} pixel um per screen pixel
 * @param {string} ink colour of the bar
 * @param {string} halo colour around it
 */
export function drawScaleBar(pen, x, y, most, pixel, ink, halo) {
  const um = roundLength(most * pixel);
  pen.font = "12px sans-serif";
  pen.textAlign = "left";
  pen.lineJoin = "round";
  for (const [colour, width] of /** @type {[string, number][]} */ ([[halo, 4], [ink, 0]])) {
    pen.strokeStyle = pen.fillStyle = colour;
    pen.lineWidth = 4 + width;
    pen.beginPath();
    pen.moveTo(x, y);
    pen.lineTo(x + um / pixel, y);
    pen.stroke();
    pen.lineWidth = 3;
    if (width) pen.strokeText(lengthWords(um), x, y - 7);
    else pen.fillText(lengthWords(um), x, y - 7);
  }
}

/** The tab Flattening: what the flattening did to the sheet as a map, and the sheet as it lay in the scanner, in space. */

import { Contrast } from "./contrast.js";
import { choice, labelled, make } from "./dom.js";
import { colourAt, paletteOf } from "./colour.js";
import { sizeOf, wholeLevel } from "./level.js";
import { MapView, flipped } from "./mapview.js";
import { drawShaded } from "./sheetmesh.js";

/**
 * @import {App} from "./main.js"
 * @import {Picture} from "./rawtiles.js"
 * @import {Relief, SheetInSpace} from "./relief.js"
 * @import {Grid} from "./sheetmesh.js"
 * @typedef {{strain: string[], space: string[], colours: string[]}} FlatSheet ids of pictures
 */

/* global ol */

const COARSER = 4; // levels beyond those of the pictures, for the first frames of a large sheet
const MOST_SHADED = 500_000; // points of the picture with shadows
const REST_MS = 150; // from a change of the colours to the sheet in them
const TURN = Math.PI / 36; // of a key
const HEIGHTS = ["1", "2", "5", "10", "20"];
const MESH_COLOUR = "rgba(20, 20, 20, 0.55)";

/**
 * Fill the tab.
 * @param {HTMLElement} panel element of the tab
 * @param {App} app session of this window
 * @returns {Promise<void>}
 */
export async function mount(panel, app) {
  const layer = encodeURIComponent(app.state.layer);
  const sheet = await app.api.get(`flattening?layer=${layer}`);
  if (!sheet) {
    panel.append(make("p", { class: "empty" }, "Neither layer of this registration is a sheet: nothing was flattened."));
    return;
  }
  const pictures = new Map(app.pictures.map((one) => [one.id, one]));
  const left = make("section", { "aria-label": "Strain" });
  const right = make("section", { "aria-label": "In space" });
  panel.append(make("div", { class: "flattening" }, left, right));
  strainMap(left, app, sheet, pictures);
  await inSpace(right, app, sheet, pictures);
}

// --- the map ---------------------------------------------------------------------------------------------------

/**
 * Show the strains as a map, with the mesh over it where it is wanted.
 * @param {HTMLElement} pane element that gets it
 * @param {App} app session of this window
 * @param {FlatSheet} sheet answer of the server
 * @param {Map<string, Picture>} pictures by their id
 */
function strainMap(pane, app, sheet, pictures) {
  const shown = sheet.strain.map((id) => pictures.get(id)).filter(Boolean);
  const bar = make("div", { class: "fields" });
  const note = make("p", { class: "soft" });
  pane.append(make("h2", {}, "Strain left by flattening"), bar, note);
  const view = new MapView({ element: pane, name: "Flat sheet", app });
  const show = (id) => {
    view.show(pictures.get(id));
    note.textContent = "0 where the sheet was laid flat without strain; 96 % of it lies within the range of colours.";
  };
  bar.append(labelled("Strain", choice(shown.map((one) => [one.id, one.title]), show)));
  const mesh = new ol.layer.Vector({ source: new ol.source.Vector(), style: { "stroke-color": MESH_COLOUR, "stroke-width": 1 }, visible: false });
  view.map.addLayer(mesh);
  const box = make("input", { type: "checkbox", onchange: () => showMesh(app, mesh, box.checked) });
  bar.append(make("label", { class: "check" }, box, " Mesh"));
  if (shown.length) show(shown[0].id);
  app.onTab((name) => name === "flattening" && view.map.updateSize());
}

/**
 * Lines of the mesh in the plane, thinned to what a screen can show; asked for once.
 * @param {App} app session of this window
 * @param {any} layer layer of OpenLayers that gets the lines
 * @param {boolean} wanted whether it is shown
 * @returns {Promise<void>}
 */
async function showMesh(app, layer, wanted) {
  layer.setVisible(wanted);
  if (!wanted || layer.getSource().getFeatures().length) return;
  const { lines, every } = await app.api.get(`mesh?layer=${encodeURIComponent(app.state.layer)}`);
  const features = lines.map((line) => new ol.Feature(new ol.geom.LineString(line.map(flipped))));
  layer.getSource().addFeatures(features);
  app.say(every > 1 ? `Every ${every}th line of the mesh is drawn.` : "All lines of the mesh are drawn.");
}

// --- the sheet in space ----------------------------------------------------------------------------------------

/**
 * Show the sheet as it lay in the scanner.
 * @param {HTMLElement} pane element that gets it
 * @param {App} app session of this window
 * @param {FlatSheet} sheet answer of the server
 * @param {Map<string, Picture>} pictures by their id
 * @returns {Promise<void>}
 */
async function inSpace(pane, app, sheet, pictures) {
  const [u, v, warp] = sheet.space.map((id) => pictures.get(id));
  const canvas = make("canvas", { class: "space", tabindex: 0, role: "img", "aria-label": "Sheet in space" });
  const bar = make("div", { class: "fields" });
  const note = make("p", { class: "soft" });
  let [colour, timer] = [pictures.get(sheet.colours[0]), 0];
  const onChange = () => {
    clearTimeout(timer);
    timer = setTimeout(redraw, REST_MS);
  };
  const scale = new Contrast({ name: "Sheet colour range", say: (text) => app.say(text), onChange });
  const showColour = async () => {
    const shade = (share) => colourAt(paletteOf(colour), share);
    scale.show({ ...colour, shade, counted: await app.histogram(colour).catch(() => null) });
  };
  pane.append(make("h2", {}, "Centre surface as it lay in the scanner"), bar, scale.element, canvas, note);
  await showColour();
  const gridAt = thinned(async (level) => {
    const [x, y, z, shown] = await Promise.all([u, v, warp, colour].map((one) => wholeLevel(app.api, one, level)));
    for (let k = 0; k < z.values.length; k++) {
      y.values[k] = -y.values[k]; // rows run down, and space has y upwards
      if (Number.isNaN(x.values[k]) || Number.isNaN(y.values[k])) z.values[k] = NaN;
    }
    const colours = coloursOf(shown.values, colour, scale.limits);
    return { rows: z.rows, cols: z.cols, x: x.values, y: y.values, z: z.values, colours };
  }, warp.levels);
  const shapeAt = (level) => {
    const own = Math.min(level, warp.levels - 1);
    return sizeOf(warp, own).map((n) => Math.ceil(n / 2 ** (level - own)));
  };
  const space = { levels: warp.levels + COARSER, step: warp.pixel_um[0], gridAt, shapeAt };
  const relief = await started(canvas, space).catch(() => null);
  const redraw = relief ? () => relief.recolour() : () => shaded(canvas, space, Number(height.value));
  const height = choice(HEIGHTS.map((n) => [n, n === "1" ? "true to scale" : `${n} times`]), (n) => {
    if (relief) relief.exaggerate(Number(n));
    else void redraw();
  });
  bar.append(
    labelled("Colour", choice(sheet.colours.map((id) => [id, pictures.get(id).title]), async (id) => {
      colour = pictures.get(id);
      await showColour();
      void redraw();
    })),
    labelled("Heights", height),
  );
  if (!relief) {
    note.textContent = "This browser has no WebGL: the sheet is shown from above, with shadows.";
    canvas.classList.add("from-above");
    await redraw();
    return;
  }
  note.textContent = "Drag or use the arrow keys to turn the sheet, the wheel or + and - to zoom.";
  canvas.addEventListener("keydown", (event) => {
    const turns = { ArrowLeft: [-TURN, 0], ArrowRight: [TURN, 0], ArrowUp: [0, TURN], ArrowDown: [0, -TURN] };
    const zooms = { "+": 1 / 1.15, "=": 1 / 1.15, "-": 1.15 };
    if (turns[event.key]) relief.turn(...turns[event.key]);
    else if (zooms[event.key]) relief.zoom(zooms[event.key]);
    else return;
    event.preventDefault();
  });
  new ResizeObserver(() => relief.resize()).observe(canvas);
}

/**
 * Red, green and blue of each value; grey where there is none.
 * @param {Float32Array} values NaN where there is none
 * @param {Picture} picture whose values they are
 * @param {number[]} limits values of the lowest and the highest colour
 * @returns {Uint8Array} three a value
 */
function coloursOf(values, picture, [low, high]) {
  const palette = paletteOf(picture);
  const table = Array.from({ length: 256 }, (_, k) => colourAt(palette, k / 255));
  const out = new Uint8Array(3 * values.length);
  for (let k = 0; k < values.length; k++) {
    const share = (values[k] - low) / (high - low || 1);
    out.set(Number.isNaN(share) ? [128, 128, 128] : table[Math.round(255 * Math.min(1, Math.max(0, share)))], 3 * k);
  }
  return out;
}

/**
 * Load three.js, which is needed here alone, and show the sheet; fails where there is no WebGL.
 * @param {HTMLCanvasElement} canvas where it is drawn
 * @param {SheetInSpace} space the sheet
 * @returns {Promise<Relief>}
 */
async function started(canvas, space) {
  const [three, { OrbitControls }, { Relief }] = await Promise.all([
    import("./vendor/three.module.js"), import("./vendor/OrbitControls.js"), import("./relief.js"),
  ]);
  const probe = document.createElement("canvas");
  if (!probe.getContext("webgl2")) throw new Error("no WebGL");
  const relief = new Relief(canvas, three, OrbitControls, space);
  await relief.start();
  return relief;
}

/**
 * Show the sheet from above, with shadows.
 * @param {HTMLCanvasElement} canvas where it is drawn
 * @param {SheetInSpace} space the sheet
 * @param {number} height by which heights are multiplied
 * @returns {Promise<void>}
 */
async function shaded(canvas, space, height) {
  let level = 0;
  while (level < space.levels - 1 && space.shapeAt(level).reduce((a, b) => a * b) > MOST_SHADED) level++;
  drawShaded(canvas, await space.gridAt(level), height);
}

/**
 * Levels beyond those that the server has: every second point of the one before.
 * @param {(level: number) => Promise<Grid>} gridAt gives the levels that the server has
 * @param {number} levels how many these are
 * @returns {(level: number) => Promise<Grid>}
 */
function thinned(gridAt, levels) {
  const at = async (level) => {
    if (level < levels) return gridAt(level);
    const { rows, cols, colours, ...places } = await at(level - 1);
    const [high, wide] = [Math.ceil(rows / 2), Math.ceil(cols / 2)];
    const out = { rows: high, cols: wide, colours: new Uint8Array(3 * high * wide) };
    for (const name of Object.keys(places)) out[name] = new Float32Array(high * wide);
    for (let r = 0, k = 0; r < high; r++) {
      for (let c = 0; c < wide; c++, k++) {
        const from = 2 * r * cols + 2 * c;
        for (const name of Object.keys(places)) out[name][k] = places[name][from];
        for (let j = 0; j < 3; j++) out.colours[3 * k + j] = colours[3 * from + j];
      }
    }
    return out;
  };
  return at;
}

// What all views share: the maps, the cursor, the selection, and what is told of them.

/**
 * @typedef {import("../../static/gestures.js").Held} Held
 * @typedef {import("../../static/gestures.js").Place} Place
 * @typedef {import("../../static/scatter.js").Points} Points
 * @typedef {"left"|"right"} PageSide
 * @typedef {{name: string, title: string, layer: string, group: number, units: string, digits: number, low: number,
 *   step: number, top: number, span: number[], range: number[], codes: Uint8Array|Uint16Array, palette: Uint8Array,
 *   colours: string, trust: string, why: string[], axis: {first: number, each: number, bins: number},
 *   row: HTMLElement}} PageMap
 *   codes from 2 to below `top` are values from `low` in steps of `step`
 * @typedef {{left: number, top: number, across: number, down: number}} SliceWindow
 *   um at the upper left corner, and um per CSS pixel
 */
const data = JSON.parse(text("data"));
const grid = data.grid, pixels = grid.rows * grid.cols;
const state = { left: 0, right: Math.min(1, data.maps.length - 1), row: grid.rows >> 1, col: grid.cols >> 1,
  held: false, region: null, brush: { left: null, right: null }, chosen: null, version: 0 };
/** @type {PageSide[]} */
const sides = ["left", "right"];

/**
 * An element of the page.
 * @param {string} id its id
 * @returns {any}
 */
const at = (id) => document.getElementById(id);

/**
 * The map of a side.
 * @param {PageSide} side the side
 * @returns {PageMap}
 */
const shown = (side) => data.maps[state[side]];

/**
 * A value within limits.
 * @param {number} v the value
 * @param {number} low lower limit
 * @param {number} high upper limit
 * @returns {number}
 */
const clamp = (v, low, high) => Math.min(Math.max(v, low), high);

/**
 * A number as it is read.
 * @param {number} v the number
 * @param {number} digits behind the point
 * @returns {string}
 */
const fixed = (v, digits) => (Math.abs(v) < 0.5 * 10 ** -digits ? 0 : v).toFixed(digits).replace("-", "−");

/**
 * A length in um as it is read.
 * @param {number} v the length
 * @returns {string}
 */
const place = (v) => fixed(v, 1);

/**
 * The name of a map, with its layer where there are several.
 * @param {PageMap} map the map
 * @returns {string}
 */
const named = (map) => map.title + (data.several ? `, ${map.layer}` : "");

/**
 * Place of a column of pixels.
 * @param {number} col from the first one
 * @returns {number} in um
 */
const xOf = (col) => grid.x0 + col * grid.dx;

/**
 * Place of a row of pixels.
 * @param {number} row from the first one
 * @returns {number} in um
 */
const yOf = (row) => grid.y0 + row * grid.dy;

/**
 * A value as it is read.
 * @param {PageMap} map whose value
 * @param {number} code its code
 * @returns {string}
 */
function written(map, code) {
  if (!code) return "–";
  const sign = code === 1 ? "< " : code === map.top ? "> " : "";
  return sign + fixed(valueOf(map, code), map.digits);
}

/**
 * What the checks doubt of the relation of two maps.
 * @param {number} i number of one map
 * @param {number} j number of the other
 * @returns {{trust: string, words: string}|null} null where they doubt nothing
 */
function doubtOf(i, j) {
  const pair = data.pairs.find((p) => p[0] === Math.min(i, j) && p[1] === Math.max(i, j));
  return pair ? { trust: pair[2], words: `${pair[2]} (${pair[3].join(", ")})` } : null;
}

/**
 * Which pixels count: valid in both maps, inside of the region and of both brushes. Sets `state.chosen` and
 * `state.found`.
 */
function choose() {
  const [a, b] = sides.map(shown), p = a.codes, q = b.codes;
  const [u, v] = [a, b].map((m) => data.groups[m.group].valid?.codes);
  const inside = [a, b].map((m, k) => {
    const limits = state.brush[sides[k]];
    return table(m, Uint8Array, (value, code) => code > 0 && (!limits || (value >= limits[0] && value <= limits[1])));
  });
  const [va, vb] = [a, b].map((m) => table(m, Float64Array, (value) => value));
  const box = state.region, marked = box || state.brush.left || state.brush.right;
  const counts = state.chosen || (state.chosen = new Uint8Array(pixels));
  let n = 0, all = 0, sa = 0, sb = 0, saa = 0, sbb = 0, sab = 0;
  const ma = (a.span[0] + a.span[1]) / 2, mb = (b.span[0] + b.span[1]) / 2;
  for (let row = 0, i = 0; row < grid.rows; row++) {
    const y = yOf(row), out = box && (y < box[1] || y > box[3]);
    for (let col = 0; col < grid.cols; col++, i++) {
      let use = 0;
      if (p[i] && q[i] && (!u || u[i]) && (!v || v[i])) {
        all++;
        const x = xOf(col);
        use = !out && inside[0][p[i]] && inside[1][q[i]] && !(box && (x < box[0] || x > box[2])) ? 1 : 0;
        if (use) {
          const s = va[p[i]] - ma, t = vb[q[i]] - mb;
          n++; sa += s; sb += t; saa += s * s; sbb += t * t; sab += s * t;
        }
      }
      counts[i] = use;
    }
  }
  const both = (saa - (sa * sa) / n) * (sbb - (sb * sb) / n);
  const hasAxis = [a, b].some((m) => m.colours === "twilight"); // those of angles of an axis, which have no r
  const r = n > 2 && both > 0 && state.left !== state.right && !hasAxis ? (sab - (sa * sb) / n) / Math.sqrt(both) : NaN;
  state.version++;
  state.found = { n, all, r, marked: Boolean(marked) };
}

/** Say how many pixels are selected, and their r. */
function tellSelection() {
  const { n, all, r, marked } = state.found, doubt = doubtOf(state.left, state.right);
  const withheld = doubt?.trust === "withheld";
  const part = marked ? `n = ${n} of ${all} pixels that count in both maps` : `n = ${all} pixels that count in both maps`;
  const about = withheld ? `r is ${doubt.words}` : Number.isNaN(r) ? "no r" : `r = ${fixed(r, 2)}${doubt ? `, ${doubt.words}` : ""}`;
  at("selection").textContent = `${part}; ${about}.${data.halved ? " Of the thinned-out maps of this page." : ""}`;
}

/**
 * The pixel of a map whose place in the volume lies closest to a place of a slice.
 * @param {any} group maps of a sheet
 * @param {any} stack its slices
 * @param {number} across um, where the slice is cut
 * @param {number} along um along the slice
 * @returns {number} -1 where there is none
 */
function pixelOf(group, stack, across, along) {
  const p = group.places[stack.rows], q = group.places[stack.cols];
  let best = Infinity, found = -1;
  const look = (row0, row1, col0, col1, step) => {
    for (let row = row0; row < row1; row += step) {
      for (let col = col0; col < col1; col += step) {
        const i = row * grid.cols + col;
        if (!p.codes[i] || !q.codes[i]) continue;
        const d = (valueOf(p, p.codes[i]) - across) ** 2 + (valueOf(q, q.codes[i]) - along) ** 2;
        if (d < best) { best = d; found = i; }
      }
    }
  };
  const step = Math.max(1, Math.round(Math.sqrt(pixels / 20000)));
  look(0, grid.rows, 0, grid.cols, step);
  if (found >= 0 && step > 1) {
    const row = Math.floor(found / grid.cols), col = found % grid.cols;
    look(Math.max(0, row - step), Math.min(grid.rows, row + step + 1), Math.max(0, col - step), Math.min(grid.cols, col + step + 1), 1);
  }
  return found;
}

/**
 * Where the cursor lies in the volume of a group.
 * @param {any} group maps of a sheet
 * @returns {Record<string, number>|null} um by axis; null beside the sheet
 */
function volumeAt(group) {
  const i = state.row * grid.cols + state.col;
  /** @type {Record<string, number>} */
  const out = {};
  for (const [axis, map] of Object.entries(group.places)) {
    if (!map.codes[i]) return null;
    out[axis] = valueOf(map, map.codes[i]);
  }
  return "x" in out ? out : null;
}

const colours = {};

/** Take the colours of the page from its style. */
function readColours() {
  const style = getComputedStyle(document.documentElement);
  for (const name of ["paper", "ink", "soft", "line", "mark", "pale"]) colours[name] = style.getPropertyValue(`--${name}`).trim();
}

/**
 * Make a canvas as sharp as the screen.
 * @param {HTMLCanvasElement} canvas the canvas
 * @param {number} high its height in CSS pixels
 * @returns {[CanvasRenderingContext2D, number, number]} its context, and its size in CSS pixels
 */
function prepared(canvas, high) {
  const wide = Math.max(canvas.parentElement.clientWidth, 50), ratio = Math.min(window.devicePixelRatio || 1, 2);
  const size = [Math.round(wide * ratio), Math.round(high * ratio)];
  if (canvas.width !== size[0] || canvas.height !== size[1]) {
    [canvas.width, canvas.height] = size;
    canvas.style.height = `${high}px`;
  }
  const pen = canvas.getContext("2d");
  pen.setTransform(ratio, 0, 0, ratio, 0, 0);
  pen.clearRect(0, 0, wide, high);
  return [pen, wide, high];
}

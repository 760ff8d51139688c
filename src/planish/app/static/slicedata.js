/** Slices of the volume as the server sends them: facts, pixels of 16 bits, lines and contours. */

/**
 * @import {Histogram} from "./contrast.js"
 * @typedef {{name: string, first_um: number, step_um: number, count: number}} SliceAxis
 * @typedef {{layer: string, direction: string, normal: string, index: number, at_um: number, across: SliceAxis,
 *   down: SliceAxis, scale: number, offset: number, missing: number, lines: string[], columns: SliceAxis|null,
 *   segments: Record<string, number>}} Facts
 * @typedef {{across: number, down: number}} SlicePlace in um along the axes of a slice
 * @typedef {SlicePlace & {face: string, draft: boolean, here: boolean}} SlicePoint of a correction; `here` in this slice
 * @typedef {Record<string, any>} VolumePlace `x`, `y` and `z` in um, and the `layer` where it is known
 */

export class Slice {
  /**
   * Read what the server sent.
   * @param {ArrayBuffer} data its answer
   */
  constructor(data) {
    const length = new DataView(data).getUint32(0, true);
    this.facts = JSON.parse(new TextDecoder().decode(new Uint8Array(data, 4, length)));
    const { across, down, columns, lines, segments } = this.facts;
    let at = 4 + length;
    this.pixels = new Uint16Array(data, at, across.count * down.count);
    at += 4 * Math.ceil(this.pixels.byteLength / 4);
    this.lines = new Map();
    for (const name of lines) {
      this.lines.set(name, new Float32Array(data, at, columns?.count ?? 0));
      at += 4 * (columns?.count ?? 0);
    }
    this.contours = new Map();
    for (const [name, count] of Object.entries(segments)) {
      this.contours.set(name, new Float32Array(data, at, 4 * count));
      at += 16 * count;
    }
  }

  /**
   * Grey value of a pixel, NaN where it is missing.
   * @param {number} row from the first one
   * @param {number} col from the first one
   * @returns {number}
   */
  value(row, col) {
    const { across, down, scale, offset, missing } = this.facts;
    if (row < 0 || col < 0 || row >= down.count || col >= across.count) return NaN;
    const code = this.pixels[row * across.count + col];
    return code === missing ? NaN : offset + scale * code;
  }

  /**
   * Column of the surfaces at a place across, -1 where there is none.
   * @param {number} um place along the slice
   * @returns {number}
   */
  column(um) {
    const { columns } = this.facts;
    if (!columns) return -1;
    const at = Math.round((um - columns.first_um) / columns.step_um);
    return at >= 0 && at < columns.count ? at : -1;
  }

  /**
   * Value of a line at a place across, NaN where there is none.
   * @param {string} name that of the line
   * @param {number} um place along the slice
   * @returns {number}
   */
  at(name, um) {
    const column = this.column(um);
    return column < 0 ? NaN : (this.lines.get(name)?.[column] ?? NaN);
  }

  /**
   * How the greys of some thousand pixels are distributed; `range` holds nearly all of them.
   * @returns {Histogram}
   */
  histogram() {
    const { missing, offset, scale } = this.facts;
    const every = Math.max(1, Math.floor(this.pixels.length / 20000));
    const seen = [];
    for (let k = 0; k < this.pixels.length; k += every) if (this.pixels[k] !== missing) seen.push(this.pixels[k]);
    seen.sort((a, b) => a - b);
    const pick = (share) => seen[Math.min(seen.length - 1, Math.floor(share * seen.length))] ?? 0;
    const [low, high] = [pick(0), Math.max(pick(1), pick(0) + 1)];
    const counts = Array(64).fill(0);
    for (const code of seen) counts[Math.min(63, Math.floor((64 * (code - low)) / (high - low)))] += 1;
    const grey = (code) => offset + scale * code;
    const range = [grey(pick(0.002)), grey(Math.max(pick(0.998), pick(0.002) + 1))];
    return { n: seen.length, low: grey(low), high: grey(high), counts, range };
  }

  /**
   * Place in the volume of a place in the slice.
   * @param {number} across um along the slice
   * @param {number} down um through the sheet
   * @param {{rows: string, cols: string, through: string}} frame axes of the sheet
   * @returns {VolumePlace} in um
   */
  place(across, down, frame) {
    const { facts } = this;
    const found = { [facts.normal]: facts.at_um, [facts.across.name]: across };
    if (facts.direction !== "straight") {
      found[facts.down.name] = down;
      return found;
    }
    found[frame.through] = this.at("place", across);
    for (const part of ["rows", "cols", "through"]) {
      found[frame[part]] += down * this.at(`normal_${part}`, across);
    }
    return found;
  }
}

/**
 * Distance in um of a place from the first pixel of an axis.
 * @param {SliceAxis} axis axis of a slice
 * @param {number} um the place
 * @returns {number}
 */
export const along = (axis, um) => (um - axis.first_um) * Math.sign(axis.step_um);

/**
 * The place so far from the first pixel.
 * @param {SliceAxis} axis axis of a slice
 * @param {number} distance in um
 * @returns {number}
 */
export const placeAt = (axis, distance) => axis.first_um + distance * Math.sign(axis.step_um);

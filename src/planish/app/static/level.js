/** One level of a picture as a whole, put together from its tiles: for the view in space, which needs all of it. */

/**
 * @import {Api} from "./api.js"
 * @import {Picture} from "./rawtiles.js"
 */

/**
 * The values of one level of a picture.
 * @param {Api} api the server
 * @param {Picture} picture as the session describes it
 * @param {number} level 0 is full resolution
 * @returns {Promise<{rows: number, cols: number, values: Float32Array}>} row by row, NaN where nothing was measured
 */
export async function wholeLevel(api, picture, level) {
  const [rows, cols] = sizeOf(picture, level);
  const { tile } = picture;
  const values = new Float32Array(rows * cols);
  const jobs = [];
  for (let r = 0; r * tile < rows; r++) {
    for (let c = 0; c * tile < cols; c++) {
      jobs.push(tileOf(api, `tiles/${picture.id}/${level}/${r}/${c}`).then((data) => {
        place(values, rows, cols, new Uint16Array(data), picture, r * tile, c * tile);
      }));
    }
  }
  await Promise.all(jobs);
  return { rows, cols, values };
}

/**
 * The bytes of a tile.
 * @param {Api} api the server
 * @param {string} path below `/api/`
 * @returns {Promise<ArrayBuffer>}
 */
const tileOf = async (api, path) => (await api.fetch(path)).arrayBuffer();

/**
 * Rows and columns of a picture at a level; each level has half as many, rounded up.
 * @param {{shape: number[]}} picture a picture
 * @param {number} level 0 is full resolution
 * @returns {number[]}
 */
export function sizeOf(picture, level) {
  return picture.shape.map((n) => {
    let size = n;
    for (let k = 0; k < level; k++) size = Math.ceil(size / 2);
    return size;
  });
}

/**
 * Put the values of a tile into the picture.
 * @param {Float32Array} values those of the picture, row by row
 * @param {number} rows of the picture
 * @param {number} cols of the picture
 * @param {Uint16Array} raw codes of the tile
 * @param {object} picture how its codes are values
 * @param {number} picture.tile rows and columns of a tile
 * @param {number} picture.scale step of one code
 * @param {number} picture.offset value of code 1
 * @param {number} top row of the tile's first pixel
 * @param {number} left column of the tile's first pixel
 */
function place(values, rows, cols, raw, { tile, scale, offset }, top, left) {
  const high = Math.min(tile, rows - top);
  const wide = Math.min(tile, cols - left);
  for (let r = 0; r < high; r++) {
    const from = r * tile;
    const to = (top + r) * cols + left;
    for (let c = 0; c < wide; c++) {
      const k = raw[from + c];
      values[to + c] = k ? offset + scale * (k - 1) : NaN;
    }
  }
}

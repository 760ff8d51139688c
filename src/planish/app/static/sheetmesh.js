/** Triangles of a sheet that is known at the points of a grid, and a picture of it with shadows where there is no WebGL. */

/**
 * @typedef {{rows: number, cols: number, x: Float32Array, y: Float32Array, z: Float32Array, colours: Uint8Array}} Grid
 *   points of a sheet, row by row, in um, y upwards, NaN where there is no sheet; three colours a point, each to 255
 */

/**
 * Triangles between two rows of a grid, without those of points where there is no sheet.
 * @param {any} three the module three.js
 * @param {Grid} grid points of the sheet
 * @param {number} top first row
 * @param {number} bottom last row
 * @returns {any} geometry of three.js; null where there is none
 */
export function stripOf(three, { rows, cols, x, y, z, colours }, top, bottom) {
  const points = (bottom - top + 1) * cols;
  const places = new Float32Array(3 * points);
  const from = top * cols;
  for (let k = 0; k < points; k++) {
    const there = !Number.isNaN(z[from + k]);
    places[3 * k] = there ? x[from + k] : 0;
    places[3 * k + 1] = there ? y[from + k] : 0;
    places[3 * k + 2] = there ? z[from + k] : 0;
  }
  const index = new Uint32Array(6 * (bottom - top) * (cols - 1));
  let used = 0;
  for (let r = 0; r < bottom - top; r++) {
    for (let c = 0; c < cols - 1; c++) {
      const a = r * cols + c;
      const [b, d, e] = [a + 1, a + cols, a + cols + 1];
      if (Number.isNaN(z[from + b]) || Number.isNaN(z[from + d])) continue;
      if (!Number.isNaN(z[from + a])) { index[used++] = a; index[used++] = d; index[used++] = b; }
      if (!Number.isNaN(z[from + e])) { index[used++] = b; index[used++] = d; index[used++] = e; }
    }
  }
  if (!used) return null;
  const geometry = new three.BufferGeometry();
  geometry.setAttribute("position", new three.BufferAttribute(places, 3));
  geometry.setAttribute("normal", new three.BufferAttribute(normalsOf({ rows, cols, x, y, z }, top, bottom), 3));
  geometry.setAttribute("color", new three.BufferAttribute(colours.subarray(3 * from, 3 * (from + points)), 3, true));
  geometry.setIndex(new three.BufferAttribute(index.subarray(0, used), 1));
  return geometry;
}

/**
 * Normals from the neighbours of every point, of the whole grid: strips meet without a seam.
 * @param {{rows: number, cols: number, x: Float32Array, y: Float32Array, z: Float32Array}} grid points of the sheet
 * @param {number} top first row
 * @param {number} bottom last row
 * @returns {Float32Array} three a point
 */
function normalsOf({ rows, cols, x, y, z }, top, bottom) {
  const out = new Float32Array(3 * (bottom - top + 1) * cols);
  for (let r = top, k = 0; r <= bottom; r++) {
    for (let c = 0; c < cols; c++, k += 3) {
      const [left, right] = [r * cols + Math.max(0, c - 1), r * cols + Math.min(cols - 1, c + 1)];
      const [up, down] = [Math.max(0, r - 1) * cols + c, Math.min(rows - 1, r + 1) * cols + c];
      const [ax, ay, az] = [x[right] - x[left], y[right] - y[left], z[right] - z[left]];
      const [bx, by, bz] = [x[up] - x[down], y[up] - y[down], z[up] - z[down]];
      const [nx, ny, nz] = [ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx];
      const length = Math.sqrt(nx * nx + ny * ny + nz * nz);
      out[k] = length > 0 ? nx / length : 0;
      out[k + 1] = length > 0 ? ny / length : 0;
      out[k + 2] = length > 0 ? nz / length : 1;
    }
  }
  return out;
}

/**
 * Middle and largest side of what is there, in um.
 * @param {{x: Float32Array, y: Float32Array, z: Float32Array}} grid points of the sheet
 * @returns {{centre: number[], size: number}}
 */
export function extentOf({ x, y, z }) {
  const range = [x, y, z].map((values) => {
    let [low, high] = [Infinity, -Infinity];
    for (const v of values) { if (v < low) low = v; if (v > high) high = v; }
    return [low, high];
  });
  return { centre: range.map(([low, high]) => (low + high) / 2), size: Math.max(...range.map(([a, b]) => b - a)) };
}

/**
 * Draw the sheet from above with the shadows that light from the upper left casts, on a canvas that needs no WebGL.
 * @param {HTMLCanvasElement} canvas where it is drawn
 * @param {Grid} grid points of the sheet
 * @param {number} height by which heights are multiplied
 */
export function drawShaded(canvas, { rows, cols, x, y, z, colours }, height) {
  canvas.width = cols;
  canvas.height = rows;
  const context = canvas.getContext("2d");
  const picture = context.createImageData(cols, rows);
  const light = [-0.5, 0.5, Math.SQRT1_2];
  const normals = normalsOf({ rows, cols, x, y, z: z.map((v) => v * height) }, 0, rows - 1);
  for (let k = 0; k < rows * cols; k++) {
    if (Number.isNaN(z[k])) continue;
    const shade = normals[3 * k] * light[0] + normals[3 * k + 1] * light[1] + normals[3 * k + 2] * light[2];
    for (let j = 0; j < 3; j++) picture.data[4 * k + j] = Math.min(255, colours[3 * k + j] * (0.3 + Math.max(0, shade)));
    picture.data[4 * k + 3] = 255;
  }
  context.putImageData(picture, 0, 0);
}

/** One level of a picture as a whole, put together from its tiles: for the view in space, which needs all of it. */

/**
 * `picture`: as the session describes it
 * `level`: 0 is full resolution
 * NaN where nothing was measured
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

const tileOf = async (api, path) => (await api.fetch(path)).arrayBuffer();

/** Rows and columns of a picture at a level; each level has half as many, rounded up. */
export function sizeOf(picture, level) {
  return picture.shape.map((n) => {
    let size = n;
    for (let k = 0; k < level; k++) size = Math.ceil(size / 2);
    return size;
  });
}

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

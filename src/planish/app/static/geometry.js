/** Plane geometry: affine maps {a, b, c, d, e, f} of points in um, (x, y) -> (a x + b y + e, c x + d y + f). */

/**
 * @typedef {number[]} Point x and y in um
 * @typedef {{a: number, b: number, c: number, d: number, e: number, f: number}} Affine
 */

/**
 * Mean of some numbers.
 * @param {number[]} values at least one
 * @returns {number}
 */
const mean = (values) => values.reduce((sum, value) => sum + value, 0) / values.length;

/**
 * The map of a similarity as the server gives it: x reversed first where it is mirrored, then turned and scaled.
 * @param {object} similarity as the server gives it
 * @param {number} similarity.scale length of a unit afterwards
 * @param {number} similarity.rotation_rad angle in the sense from x to y
 * @param {number[]} similarity.shift_um where the origin lies afterwards
 * @param {boolean} similarity.mirrored whether x is reversed
 * @returns {Affine}
 */
export function ofSimilarity({ scale, rotation_rad, shift_um, mirrored }) {
  const [cos, sin] = [scale * Math.cos(rotation_rad), scale * Math.sin(rotation_rad)];
  const flip = mirrored ? -1 : 1;
  return { a: cos * flip, b: -sin, c: sin * flip, d: cos, e: shift_um[0], f: shift_um[1] };
}

/**
 * Least-squares affine map.
 * @param {Point[]} from points in um
 * @param {Point[]} to where they lie afterwards
 * @returns {Affine|null} null below three pairs, or where the points lie on a line
 */
export function affine(from, to) {
  const [mx, my] = [mean(from.map((p) => p[0])), mean(from.map((p) => p[1]))];
  const [nx, ny] = [mean(to.map((p) => p[0])), mean(to.map((p) => p[1]))];
  let [xx, xy, yy, xu, yu, xv, yv] = [0, 0, 0, 0, 0, 0, 0];
  from.forEach((p, i) => {
    const [x, y, u, v] = [p[0] - mx, p[1] - my, to[i][0] - nx, to[i][1] - ny];
    xx += x * x;
    xy += x * y;
    yy += y * y;
    xu += x * u;
    yu += y * u;
    xv += x * v;
    yv += y * v;
  });
  const determinant = xx * yy - xy * xy;
  if (from.length < 3 || determinant < 1e-6 * (xx + yy) ** 2) return null;
  const a = (xu * yy - yu * xy) / determinant;
  const b = (yu * xx - xu * xy) / determinant;
  const c = (xv * yy - yv * xy) / determinant;
  const d = (yv * xx - xv * xy) / determinant;
  return { a, b, c, d, e: nx - a * mx - b * my, f: ny - c * mx - d * my };
}

/**
 * The place to which a map takes a point.
 * @param {Affine} map the map
 * @param {Point} point in um
 * @returns {Point}
 */
export const mapped = (map, [x, y]) => [map.a * x + map.b * y + map.e, map.c * x + map.d * y + map.f];

/**
 * The map that takes all points back.
 * @param {Affine} map the map
 * @returns {Affine}
 */
export function inverse({ a, b, c, d, e, f }) {
  const determinant = a * d - b * c;
  const [p, q, r, s] = [d / determinant, -b / determinant, -c / determinant, a / determinant];
  return { a: p, b: q, c: r, d: s, e: -(p * e + q * f), f: -(r * e + s * f) };
}

/**
 * Scale of a map: the root of the area that it gives to a unit square.
 * @param {Affine} map the map
 * @returns {number}
 */
export const scaleOf = ({ a, b, c, d }) => Math.sqrt(Math.abs(a * d - b * c));

/**
 * Whether a map is a mirror image.
 * @param {Affine} map the map
 * @returns {boolean}
 */
export const isMirrored = ({ a, b, c, d }) => a * d - b * c < 0;

/**
 * Angle by which a map turns the sheet, in radians, in the sense from x to y.
 * @param {Affine} map the map
 * @returns {number}
 */
export const angleOf = ({ b, d }) => Math.atan2(-b, d);

/**
 * A turn by an angle in radians, in the sense from x to y.
 * @param {number} angle in radians
 * @returns {Affine}
 */
export const turned = (angle) => {
  const [cos, sin] = [Math.cos(angle), Math.sin(angle)];
  return { a: cos, b: -sin, c: sin, d: cos, e: 0, f: 0 };
};

/**
 * One map after another.
 * @param {Affine} last the map that is applied second
 * @param {Affine} first the map that is applied first
 * @returns {Affine}
 */
export const after = (last, first) => ({
  a: last.a * first.a + last.b * first.c,
  b: last.a * first.b + last.b * first.d,
  c: last.c * first.a + last.d * first.c,
  d: last.c * first.b + last.d * first.d,
  e: last.a * first.e + last.b * first.f + last.e,
  f: last.c * first.e + last.d * first.f + last.f,
});

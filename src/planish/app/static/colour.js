/** Colours of values: the scales of the report, and tables that give the colour of every 16-bit code. */

/**
 * @typedef {number[]} Colour red, green, blue, each to 255
 * @typedef {(share: number) => number[]|Uint8Array} Shade the colour of a share from 0 to 1
 */

/** Anchors at even distances, from the lowest value to the highest; those of planish.report. */
export const PALETTES = {
  viridis:
    "440154 48186a 472d7b 424086 3b528b 33638d 2c728e 26818e 21908c 1f9f88 28ae80 3ebc74 5dc963 82d34c abdc32 d5e21a fde725",
  cividis:
    "00224e 002e6a 1a386f 32436d 434e6c 52596d 61656f 6f7073 7c7b78 8b8778 9b9376 aba072 bbad6c ccba64 ddc958 efd748 fee838",
  magma:
    "000004 0a0822 1d1146 36106a 50127c 691c81 822681 9c2e7f b63779 cf4170 e65163 f5695c fb8761 fea571 fec387 fde0a2 fcfdbf",
  RdBu_r:
    "053061 175290 2a71b2 3f8dc0 6bacd0 9ac9e0 c1ddec dfecf3 f7f7f6 fbe6d9 fbceb6 f5ac8b e58268 d25749 bb2a34 960f26 67001f",
  twilight:
    "e2d9e2 c4ced4 95b5c7 7297c1 6276ba 5e51ad 592a8f 45135c 2f1436 4a1342 741e4f 983550 b25652 c27c63 cca389 d8c7be e2d9e2",
  grey: "000000 ffffff",
};

/** What a brush has chosen, [red, green, blue]. */
export const CHOSEN = [255, 72, 0];

const CODES = 65536;

/**
 * A colour as it lies in the memory of a canvas.
 * @param {Colour} rgb red, green, blue, each to 255
 * @param {number} [alpha] to 255
 * @returns {number} 32 bits
 */
export const packed = ([red, green, blue], alpha = 255) =>
  ((alpha << 24) | (Math.round(blue) << 16) | (Math.round(green) << 8) | Math.round(red)) >>> 0;

/**
 * The colour at a place of a scale.
 * @param {string} palette a key of `PALETTES`
 * @param {number} share 0 to 1
 * @returns {Colour} red, green, blue
 */
export function colourAt(palette, share) {
  const anchors = (PALETTES[(palette)] ?? PALETTES.viridis).split(" ");
  const at = Math.min(Math.max(share, 0), 1) * (anchors.length - 1);
  const k = Math.min(Math.floor(at), anchors.length - 2);
  const [low, high] = [anchors[k], anchors[k + 1]].map((hex) => [0, 2, 4].map((i) => parseInt(hex.slice(i, i + 2), 16)));
  return low.map((value, i) => value + (high[i] - value) * (at - k));
}

/**
 * The scale that suits a picture.
 * @param {object} picture a picture of the session
 * @param {string} picture.name layer and variable
 * @param {string} picture.units ASCII
 * @returns {string} a key of `PALETTES`
 */
export function paletteOf({ name, units }) {
  const variable = name.split("/").at(-1) ?? name;
  if (variable === "image" || variable === "valid" || variable.startsWith("presence")) return "grey";
  if (units === "%" || units === "mrad") return "RdBu_r"; // strains, around 0
  if (variable.endsWith("_se") || variable.includes("error")) return "magma";
  return units === "deg" || variable === "warp" || /^(u|v|volume_.|projected_.)$/.test(variable) ? "cividis" : "viridis";
}

/**
 * The colour of each code of a picture; code 0 is missing and transparent.
 * @param {object} picture how its codes are values
 * @param {number} picture.scale step of one code
 * @param {number} picture.offset value of code 1
 * @param {object} look how it is coloured
 * @param {string} look.palette a key of `PALETTES`
 * @param {number} look.low value of the lowest colour
 * @param {number} look.high value of the highest colour
 * @returns {Uint32Array} as canvas memory has them, by code
 */
export function coloursOfCodes({ scale, offset }, { palette, low, high }) {
  const shades = Uint32Array.from({ length: 256 }, (_, k) => packed(colourAt(palette, k / 255)));
  const table = new Uint32Array(CODES);
  const step = (255 * scale) / (high - low || 1);
  const start = (255 * (offset - low)) / (high - low || 1);
  for (let code = 1; code < CODES; code++) {
    const shade = start + step * (code - 1) + 0.5;
    table[code] = shades[shade < 0 ? 0 : shade > 255 ? 255 : shade | 0];
  }
  return table;
}

/**
 * The codes of a picture whose values lie between two; the first and the last code stand for all values beyond. None
 * where the first is above the second
 * @param {object} picture how its codes are values
 * @param {number} picture.scale step of one code
 * @param {number} picture.offset value of code 1
 * @param {number} low lowest value that counts
 * @param {number} high highest value that counts
 * @returns {[number, number]} first and last code; none counts where the first is above the second
 */
export function codesBetween({ scale, offset }, low, high) {
  const first = Math.ceil((low - offset) / scale - 1e-6) + 1;
  const last = Math.floor((high - offset) / scale + 1e-6) + 1;
  return [Math.min(Math.max(first, 1), CODES - 1), Math.max(Math.min(last, CODES - 1), 0)];
}

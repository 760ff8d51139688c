// Packed maps to typed arrays: base64, inflated, differences summed.

/**
 * The text of an element.
 * @param {string} id its id
 * @returns {string}
 */
const text = (id) => document.getElementById(id).textContent;

/**
 * Bytes of a text in base64.
 * @param {string} base64 the text
 * @returns {Uint8Array<ArrayBuffer>}
 */
function bytesOf(base64) {
  const letters = atob(base64), out = new Uint8Array(letters.length);
  for (let i = 0; i < out.length; i++) out[i] = letters.charCodeAt(i);
  return out;
}

/**
 * Unpack a map.
 * @param {any} spec how it is packed, and the block of the page that holds it
 * @returns {Promise<PageMap>}
 */
async function unpack(spec) {
  const stream = new Blob([bytesOf(text(spec.block))]).stream().pipeThrough(new DecompressionStream("deflate"));
  const raw = new Uint8Array(await new Response(stream).arrayBuffer()), size = spec.rows * spec.cols;
  const codes = spec.bits === 8 ? raw : new Uint16Array(size);
  if (spec.bits === 16) {
    for (let i = 0; i < size; i++) {
      const folded = raw[i] | (raw[size + i] << 8);
      codes[i] = (folded >>> 1) ^ -(folded & 1);
    }
  }
  if (spec.order === 2) for (let i = spec.cols; i < size; i++) codes[i] += codes[i - spec.cols];
  for (let i = 0; i < size; i++) if (i % spec.cols) codes[i] += codes[i - 1];
  return { ...spec, codes, top: 2 ** spec.bits - 1 };
}

/**
 * The value of a code: 0 is missing, 1 below the range, the largest one above it.
 * @param {PageMap} map whose code it is
 * @param {number} code the code
 * @returns {number} NaN where it is missing
 */
const valueOf = (map, code) => (code ? map.low + map.step * (Math.min(Math.max(code, 2), map.top - 1) - 2) : NaN);

/**
 * One value for every code, so that pixels are looked up and not computed.
 * @param {PageMap} map whose codes
 * @param {any} type class of the array
 * @param {(value: number, code: number) => any} of gives the value
 * @returns {any} the array, by code
 */
function table(map, type, of) {
  const out = new type(map.top + 1);
  for (let code = 0; code <= map.top; code++) out[code] = of(valueOf(map, code), code);
  return out;
}

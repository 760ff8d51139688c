// How many pixels have which values of the left and of the right map.
const MOST_BINS = 128;

/**
 * Bins of equally many codes, so that none is fuller than its neighbours by the packing alone.
 * @param {PageMap} map the map
 * @returns {{axis: {first: number, each: number, bins: number}, span: number[]}} bins in codes, and the values that
 *   they span
 */
function axisOf(map) {
  const code = (v) => clamp(Math.round((v - map.low) / map.step) + 2, 2, map.top - 1);
  const first = code(map.span[0]), many = Math.max(code(map.span[1]) - first + 1, 2), each = Math.ceil(many / MOST_BINS);
  const bins = Math.ceil(many / each), low = map.low + map.step * (first - 2.5);
  return { axis: { first, each, bins }, span: [low, low + map.step * each * bins] };
}

/**
 * All points that count, and those that are chosen.
 * @param {PageMap} a map to the right
 * @param {PageMap} b map upwards
 * @returns {Points}
 */
function pointsOf(a, b) {
  const valid = [a, b].map((m) => data.groups[m.group].valid?.codes);
  const bins = [a, b].map((m) => table(m, Uint8Array, (value, code) => {
    const k = code > 1 && code < m.top ? Math.floor((code - m.axis.first) / m.axis.each) : 255;
    return k >= 0 && k < m.axis.bins ? k : 255;
  }));
  const [wide, tall] = [a.axis.bins, b.axis.bins];
  const counts = new Uint32Array(wide * tall), chosen = new Uint32Array(wide * tall);
  for (let i = 0; i < pixels; i++) {
    const x = bins[0][a.codes[i]], y = bins[1][b.codes[i]];
    if (x === 255 || y === 255 || (valid[0] && !valid[0][i]) || (valid[1] && !valid[1][i])) continue;
    counts[y * wide + x]++;
    chosen[y * wide + x] += state.chosen[i];
  }
  const axes = [a, b].map((map) => ({ label: named(map) + (map.units ? `, ${map.units}` : ""), low: map.span[0], high: map.span[1] }));
  return { axes, wide, tall, counts, chosen: state.found.marked ? chosen : null };
}

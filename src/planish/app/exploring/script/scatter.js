// How many pixels have which values of the left and of the right map; what is chosen stands out.
const MOST_BINS = 128, MARGIN = { left: 62, right: 22, top: 10, bottom: 44 };

// Bins of equally many codes, so that none is fuller than its neighbours by the packing alone.
function axisOf(map) {
  const code = (v) => clamp(Math.round((v - map.low) / map.step) + 2, 2, map.top - 1);
  const first = code(map.span[0]), many = Math.max(code(map.span[1]) - first + 1, 2), each = Math.ceil(many / MOST_BINS);
  const bins = Math.ceil(many / each), low = map.low + map.step * (first - 2.5);
  return { axis: { first, each, bins }, span: [low, low + map.step * each * bins] };
}

class Scatter {
  constructor() {
    this.frame = at("scatter");
    this.picture = document.createElement("canvas");
    for (const [name, of] of [["pointerdown", this.pressed], ["pointermove", this.moved], ["pointerup", this.released]]) this.frame.addEventListener(name, of.bind(this));
    this.frame.addEventListener("keydown", (event) => this.key(event));
  }

  // Numbers of pixels in each bin: grey all that count, coloured those that are chosen.
  paint() {
    const [a, b] = sides.map(shown), valid = [a, b].map((m) => data.groups[m.group].valid?.codes);
    const bins = [a, b].map((m) => table(m, Uint8Array, (value, code) => {
      const k = code > 1 && code < m.top ? Math.floor((code - m.axis.first) / m.axis.each) : 255;
      return k >= 0 && k < m.axis.bins ? k : 255;
    }));
    const [wide, tall] = [a.axis.bins, b.axis.bins], counts = state.chosen;
    const all = new Uint32Array(wide * tall), chosen = new Uint32Array(wide * tall);
    for (let i = 0; i < pixels; i++) {
      const x = bins[0][a.codes[i]], y = bins[1][b.codes[i]];
      if (x === 255 || y === 255 || (valid[0] && !valid[0][i]) || (valid[1] && !valid[1][i])) continue;
      const k = (tall - 1 - y) * wide + x;
      all[k]++;
      chosen[k] += counts[i];
    }
    const most = Math.log(1 + all.reduce((m, v) => Math.max(m, v), 1)), image = new ImageData(wide, tall), shades = data.ramp;
    for (let k = 0; k < all.length; k++) {
      if (!all[k]) continue;
      const share = Math.log(1 + (chosen[k] || all[k])) / most, s = 3 * Math.round(254 * share);
      const grey = 205 - 90 * share;
      image.data.set(chosen[k] ? [shades[s], shades[s + 1], shades[s + 2], 255] : [grey, grey, grey, 255], 4 * k);
    }
    [this.picture.width, this.picture.height] = [wide, tall];
    this.picture.getContext("2d").putImageData(image, 0, 0);
  }

  draw() {
    const high = clamp(0.82 * this.frame.clientWidth, 200, 340), [pen, w, h] = prepared(at("scatter-plot"), high);
    this.area = [MARGIN.left, MARGIN.top, w - MARGIN.left - MARGIN.right, h - MARGIN.top - MARGIN.bottom];
    const [x, y, wide, tall] = this.area, [a, b] = sides.map(shown), doubt = doubtOf(state.left, state.right);
    pen.fillStyle = colours.ink; pen.font = "12px sans-serif"; pen.strokeStyle = colours.soft; pen.lineWidth = 1;
    if (doubt?.trust === "withheld") { this.withheld = true; pen.fillText("Withheld by the checks; not drawn.", x, y + 20); return; }
    this.withheld = false;
    pen.imageSmoothingEnabled = false;
    pen.drawImage(this.picture, x, y, wide, tall);
    pen.strokeRect(x + 0.5, y + 0.5, wide, tall);
    for (const k of [0, 1, 2, 3, 4]) {
      const u = a.span[0] + (k / 4) * (a.span[1] - a.span[0]), v = b.span[0] + (k / 4) * (b.span[1] - b.span[0]);
      if (k % 2 === 0 || wide > 240) { pen.textAlign = "center"; pen.fillText(brief(u, a), x + (wide * k) / 4, y + tall + 16); }
      pen.textAlign = "right"; pen.fillText(brief(v, b), x - 6, y + tall * (1 - k / 4) + 4);
    }
    pen.fillStyle = colours.soft; pen.textAlign = "center";
    pen.fillText(label(a), x + wide / 2, h - 8, wide + 40);
    pen.save(); pen.translate(12, y + tall / 2); pen.rotate(-Math.PI / 2); pen.fillText(label(b), 0, 0, tall); pen.restore();
    pen.textAlign = "left";
    const [p, q] = this.brush();
    if (this.drag || state.brush.left || state.brush.right) {
      const [x0, y1] = this.screen(p[0], q[0]), [x1, y0] = this.screen(p[1], q[1]);
      for (const [colour, width] of [["#fff", 3.5], ["#c22", 1.6]]) { pen.strokeStyle = colour; pen.lineWidth = width; pen.strokeRect(x0, y0, x1 - x0, y1 - y0); }
    }
    const i = state.row * grid.cols + state.col;
    if (!a.codes[i] || !b.codes[i]) return;
    const [cx, cy] = this.screen(valueOf(a, a.codes[i]), valueOf(b, b.codes[i]));
    for (const [colour, width] of [["#fff", 4], ["#111", 1.8]]) { pen.strokeStyle = colour; pen.lineWidth = width; pen.beginPath(); pen.arc(clamp(cx, x, x + wide), clamp(cy, y, y + tall), 5, 0, 7); pen.stroke(); }
  }

  brush() { return this.drag || sides.map((side) => state.brush[side] || shown(side).span); }

  screen(u, v) {
    const [x, y, wide, tall] = this.area, [a, b] = sides.map((side) => shown(side).span);
    return [x + (wide * (u - a[0])) / (a[1] - a[0]), y + tall * (1 - (v - b[0]) / (b[1] - b[0]))];
  }

  values(event) {
    const box = this.frame.getBoundingClientRect(), [x, y, wide, tall] = this.area, [a, b] = sides.map((side) => shown(side).span);
    const [s, t] = [clamp((event.clientX - box.left - x) / wide, 0, 1), clamp(1 - (event.clientY - box.top - y) / tall, 0, 1)];
    return [a[0] + s * (a[1] - a[0]), b[0] + t * (b[1] - b[0])];
  }

  pressed(event) {
    if (event.button || this.withheld) return;
    this.start = this.values(event);
    this.frame.setPointerCapture(event.pointerId);
  }

  moved(event) {
    if (!this.start) return;
    const here = this.values(event);
    this.drag = [0, 1].map((k) => [Math.min(here[k], this.start[k]), Math.max(here[k], this.start[k])]);
    setBrush(...this.drag);
  }

  released() {
    if (this.start && !this.drag) setBrush(null, null);
    this.start = this.drag = null;
  }

  key(event) {
    if (event.key === "Escape") clearSelection();
    else if (event.key === "Enter") setBrush(...sides.map((side) => { const [low, high] = shown(side).span; return [low + 0.4 * (high - low), low + 0.6 * (high - low)]; }));
    else if (event.key.startsWith("Arrow") && (state.brush.left || state.brush.right)) {
      const across = event.key === "ArrowLeft" || event.key === "ArrowRight", k = across ? 0 : 1;
      const sign = event.key === "ArrowRight" || event.key === "ArrowUp" ? 1 : -1, found = this.brush().map((v) => [...v]);
      const [low, high] = shown(sides[k]).span, step = sign * 0.02 * (high - low);
      found[k][1] += step;
      if (!event.shiftKey) found[k][0] += step;
      if (found[k][1] > found[k][0]) setBrush(...found);
    } else return;
    event.preventDefault();
  }
}

const label = (map) => named(map) + (map.units ? ` / ${map.units}` : "");
const brief = (v, map) => fixed(v, clamp(1 - Math.floor(Math.log10(map.span[1] - map.span[0])), 0, map.digits));

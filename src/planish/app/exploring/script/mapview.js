// A map: its colours, the shared window onto it, the cursor, and regions that are drawn.
const view = { x: 0, y: 0, um: 0 }; // middle of the window, and um per CSS pixel; 0 shows the whole map
const width_um = grid.cols * grid.dx, height_um = grid.rows * grid.dy;

class MapView {
  constructor(side) {
    this.side = side;
    this.frame = at(`${side}-view`);
    this.canvas = at(`${side}-map`);
    this.picture = document.createElement("canvas");
    [this.picture.width, this.picture.height] = [grid.cols, grid.rows];
    this.pixels = new ImageData(grid.cols, grid.rows);
    this.words = new Uint32Array(this.pixels.data.buffer);
    this.limits = null;
    this.frame.addEventListener("pointermove", (event) => this.moved(event));
    this.frame.addEventListener("pointerdown", (event) => this.pressed(event));
    this.frame.addEventListener("pointerup", (event) => this.released(event));
    this.frame.addEventListener("pointercancel", () => { this.start = null; });
    this.frame.addEventListener("keydown", (event) => this.key(event));
    this.frame.addEventListener("wheel", (event) => this.wheel(event), { passive: false });
  }

  // Colours of all pixels; those that do not count are pale.
  paint() {
    const map = shown(this.side), [low, high] = this.limits || map.range, shades = map.palette;
    const none = parseInt(data.missing.slice(1), 16), grey = [none >> 16, (none >> 8) & 255, none & 255];
    const word = (share, of) => {
      const k = 3 * clamp(Math.round(254 * share), 0, 254);
      const [r, g, b] = [0, 1, 2].map((c) => Math.round(of * shades[k + c] + (1 - of) * grey[c]));
      return (255 << 24) | (b << 16) | (g << 8) | r;
    };
    const colour = (of) => table(map, Uint32Array, (value, code) => (code ? word((value - low) / (high - low || 1), of) : word(0, 0)));
    const full = colour(1), pale = colour(0.3), counts = state.chosen, codes = map.codes;
    const valid = data.groups[map.group].valid?.codes, marked = state.found.marked;
    for (let i = 0; i < pixels; i++) this.words[i] = (marked ? counts[i] : !valid || valid[i]) ? full[codes[i]] : pale[codes[i]];
    this.picture.getContext("2d").putImageData(this.pixels, 0, 0);
    const bar = at(`${this.side}-bar`).getContext("2d"), strip = new ImageData(255, 1);
    for (let k = 0; k < 255; k++) strip.data.set([shades[3 * k], shades[3 * k + 1], shades[3 * k + 2], 255], 4 * k);
    bar.putImageData(strip, 0, 0);
    const scale = at(`${this.side}-scale`), digits = Math.max(map.digits, high - low < 10 ? 1 : 0);
    scale.replaceChildren(...[low, (low + high) / 2, high].map((v) => Object.assign(document.createElement("span"), { textContent: fixed(v, digits) })));
    scale.children[1].textContent += map.units ? ` ${map.units}` : "";
  }

  draw() {
    const wide = this.frame.clientWidth, high = clamp((wide * height_um) / width_um, 120, 0.72 * window.innerHeight);
    const [pen, w, h] = prepared(this.canvas, Math.round(high));
    this.size = [w, h];
    const whole = Math.max(width_um / w, height_um / h);
    if (!view.um || view.um > whole) Object.assign(view, { um: whole, x: grid.x0 + (width_um - grid.dx) / 2, y: grid.y0 + (height_um - grid.dy) / 2 });
    this.whole = whole;
    const [left, top] = this.screen(grid.x0 - grid.dx / 2, grid.y0 - grid.dy / 2);
    pen.imageSmoothingEnabled = view.um > grid.dx;
    pen.drawImage(this.picture, left, top, width_um / view.um, height_um / view.um);
    this.drawTrace(pen);
    const box = this.drag || state.region;
    if (box) {
      const [x0, y0] = this.screen(box[0], box[1]), [x1, y1] = this.screen(box[2], box[3]);
      for (const [colour, width] of [["#fff", 4], ["#111", 1.6]]) { pen.strokeStyle = colour; pen.lineWidth = width; pen.strokeRect(x0, y0, x1 - x0, y1 - y0); }
    }
    const [x, y] = this.screen(xOf(state.col), yOf(state.row));
    for (const [colour, width] of [["#fff", 4], ["#111", 1.6]]) {
      pen.strokeStyle = colour; pen.lineWidth = width;
      pen.beginPath();
      for (const [a, b] of [[-14, -4], [4, 14]]) { pen.moveTo(x + a, y); pen.lineTo(x + b, y); pen.moveTo(x, y + a); pen.lineTo(x, y + b); }
      pen.stroke();
    }
    scaleBar(pen, 12, h - 12, Math.min(w / 3, 160), view.um, "#111", "#fff");
  }

  // Where the slice cuts the sheet, from A to B.
  drawTrace(pen) {
    if (!trace.length) return;
    for (const [colour, size] of [["#fff", 3], ["#c22", 1.6]]) {
      pen.fillStyle = colour;
      for (const i of trace) {
        const [x, y] = this.screen(xOf(i % grid.cols), yOf(Math.floor(i / grid.cols)));
        pen.fillRect(x - size / 2, y - size / 2, size, size);
      }
    }
    pen.font = "bold 13px sans-serif"; pen.lineJoin = "round"; pen.lineWidth = 3; pen.strokeStyle = "#fff"; pen.fillStyle = "#c22";
    for (const [letter, i] of [["A", trace.first], ["B", trace.last]]) {
      const [x, y] = this.screen(xOf(i % grid.cols), yOf(Math.floor(i / grid.cols)));
      const here = [clamp(x - 4, 2, this.size[0] - 12), clamp(y - 6, 12, this.size[1] - 4)];
      pen.strokeText(letter, ...here); pen.fillText(letter, ...here);
    }
  }

  screen(x, y) { return [(x - view.x) / view.um + this.size[0] / 2, (y - view.y) / view.um + this.size[1] / 2]; }

  um(event) {
    const box = this.frame.getBoundingClientRect();
    return [view.x + (event.clientX - box.left - this.size[0] / 2) * view.um, view.y + (event.clientY - box.top - this.size[1] / 2) * view.um];
  }

  go(event) {
    const [x, y] = this.um(event);
    moveTo(Math.round((y - grid.y0) / grid.dy), Math.round((x - grid.x0) / grid.dx));
  }

  moved(event) {
    if (this.start && event.pointerType !== "touch") {
      const [x, y] = this.um(event), [x0, y0] = this.start.um;
      if (this.start.pan) { view.x += x0 - x; view.y += y0 - y; redraw("window"); return; }
      if (Math.hypot(event.clientX - this.start.x, event.clientY - this.start.y) > 4) {
        this.drag = [Math.min(x, x0), Math.min(y, y0), Math.max(x, x0), Math.max(y, y0)];
        redraw("window");
        return;
      }
    }
    if (!state.held && event.pointerType !== "touch") this.go(event);
  }

  pressed(event) {
    if (event.button) return;
    this.start = { um: this.um(event), x: event.clientX, y: event.clientY, pan: event.shiftKey };
    if (event.pointerType !== "touch") this.frame.setPointerCapture(event.pointerId);
  }

  released(event) {
    if (!this.start) return;
    const { pan } = this.start, drag = this.drag;
    this.start = this.drag = null;
    if (drag) setRegion(drag);
    else if (!pan) { this.go(event); state.held = event.pointerType === "touch" || !state.held; redraw("cursor"); }
  }

  wheel(event) {
    if (!event.ctrlKey && !event.metaKey) return;
    event.preventDefault();
    zoom(event.deltaY < 0 ? 1.25 : 0.8, this.um(event));
  }

  key(event) {
    const many = event.shiftKey ? 10 : 1;
    const step = { ArrowLeft: [0, -many], ArrowRight: [0, many], ArrowUp: [-many, 0], ArrowDown: [many, 0] }[event.key];
    if (step) { state.held = true; moveTo(state.row + step[0], state.col + step[1]); follow(this.size); }
    else if (event.key === "+" || event.key === "=") zoom(1.25);
    else if (event.key === "-" || event.key === "−") zoom(0.8);
    else if (event.key === "0") zoom(0);
    else if (event.key === "Enter") this.corner();
    else if (event.key === "Escape") clearSelection();
    else return;
    event.preventDefault();
  }

  // By keys: the first Enter sets a corner, the second one the other.
  corner() {
    const here = [xOf(state.col), yOf(state.row)], first = this.first;
    this.first = first ? null : here;
    if (first) setRegion([Math.min(first[0], here[0]), Math.min(first[1], here[1]), Math.max(first[0], here[0]), Math.max(first[1], here[1])]);
    else at("selection").textContent = "First corner of the region set. Move the cursor and press Enter again.";
  }
}

// Around a place, by default the cursor; 0 shows the whole map.
function zoom(factor, around = [xOf(state.col), yOf(state.row)]) {
  if (!factor) view.um = 0;
  else {
    const um = clamp(view.um / factor, Math.min(grid.dx, grid.dy) / 16, views[0].whole), share = um / view.um;
    view.x = around[0] + (view.x - around[0]) * share;
    view.y = around[1] + (view.y - around[1]) * share;
    view.um = um;
  }
  redraw("window");
}

// Keep the cursor in the window when keys move it.
function follow(size) {
  const [x, y] = [xOf(state.col), yOf(state.row)], reach = [0.45 * size[0] * view.um, 0.45 * size[1] * view.um];
  if (view.um >= views[0].whole) return;
  view.x = clamp(view.x, x - reach[0], x + reach[0]);
  view.y = clamp(view.y, y - reach[1], y + reach[1]);
  redraw("window");
}

// A map: its colours, the shared window onto it, the cursor, and regions that are drawn.
const view = { x: 0, y: 0, um: 0 }; // middle of the window, and um per CSS pixel; 0 shows the whole map
const width_um = grid.cols * grid.dx, height_um = grid.rows * grid.dy;

/** @type {[string, number][]} a light line below a dark one, seen on any ground: colour and width */
const LINES_OF_CROSS = [["#fff", 4], ["#111", 1.6]];

class MapView {
  /**
   * Make the view of a side.
   * @param {PageSide} side the side
   */
  constructor(side) {
    this.side = side;
    this.name = `${side === "left" ? "Left" : "Right"} map`;
    this.frame = at(`${side}-view`);
    this.canvas = at(`${side}-map`);
    this.picture = document.createElement("canvas");
    [this.picture.width, this.picture.height] = [grid.cols, grid.rows];
    this.pixels = new ImageData(grid.cols, grid.rows);
    this.words = new Uint32Array(this.pixels.data.buffer);
    const say = (words) => { at("message").textContent = words; };
    this.contrast = new Contrast({ name: `${this.name.split(" ")[0]} colour range`, say, onChange: () => { say(""); redraw("colours"); } });
    this.contrast.field.id = `${side}-range`;
    this.tool = make("button", { type: "button", "aria-pressed": "false", title: "Drag a region; or drag with Shift" }, "Region");
    this.tool.addEventListener("click", () => this.tool.setAttribute("aria-pressed", String(this.tool.ariaPressed !== "true")));
    const tools = viewBar(this.name, { zoom, fit: () => zoom(0), svg: () => this.svg() });
    tools.prepend(this.tool);
    this.frame.previousElementSibling.append(tools);
    this.frame.after(this.contrast.element);
    bindGestures(this.frame, {
      pan: (right, down) => { view.x -= right * view.um; view.y -= down * view.um; redraw("window"); },
      zoom: (factor, place) => zoom(factor, this.um(place)),
      hover: (place) => { if (place && !state.held) this.go(place); },
      click: (place) => { this.go(place); state.held = !state.held; redraw("cursor"); },
      take: (from, shift) => (shift || this.tool.ariaPressed === "true" ? this.region(this.um(from)) : null),
    });
    this.frame.addEventListener("keydown", (event) => { if (event.target === this.frame) this.key(event); });
  }

  /** Take the map that is shown: colours begin with its limits, and with how its values are distributed. */
  choose() {
    const map = shown(this.side), { low, step, codes, palette } = map, valid = data.groups[map.group].valid?.codes;
    const [from, to] = map.span, counts = new Array(128).fill(0);
    for (let i = 0; i < pixels; i++) {
      const k = codes[i] && (!valid || valid[i]) ? Math.floor((128 * (low + step * (codes[i] - 2) - from)) / (to - from)) : -1;
      if (k >= 0 && k < 128) counts[k]++;
    }
    const n = counts.reduce((sum, one) => sum + one, 0);
    const shade = (share) => { const k = 3 * clamp(Math.round(254 * share), 0, 254); return [palette[k], palette[k + 1], palette[k + 2]]; };
    const title = named(map);
    this.contrast.show({ title, name: title, units: map.units, range: map.range, shade, counted: { n, low: from, high: to, counts, range: map.range } });
  }

  /** Give each pixel its colour; those that do not count are pale. */
  paint() {
    const map = shown(this.side), [low, high] = this.contrast.limits, shades = map.palette;
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
  }

  /** Draw the map, the region and the cursor. */
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
      for (const [colour, width] of LINES_OF_CROSS) { pen.strokeStyle = colour; pen.lineWidth = width; pen.strokeRect(x0, y0, x1 - x0, y1 - y0); }
    }
    const [x, y] = this.screen(xOf(state.col), yOf(state.row));
    for (const [colour, width] of LINES_OF_CROSS) {
      pen.strokeStyle = colour; pen.lineWidth = width;
      pen.beginPath();
      for (const [a, b] of [[-14, -4], [4, 14]]) { pen.moveTo(x + a, y); pen.lineTo(x + b, y); pen.moveTo(x, y + a); pen.lineTo(x, y + b); }
      pen.stroke();
    }
    drawScaleBar(pen, 12, h - 12, Math.min(w / 3, 160), view.um, "#111", "#fff");
  }

  /**
   * The map as it is seen.
   * @returns {string} as SVG
   */
  svg() {
    const map = shown(this.side), [wide, tall] = this.size, { limits, values } = this.contrast;
    const words = limits.map((v, k) => fixed(v, map.digits) + (k && map.units ? ` ${map.units}` : ""));
    return svgOf(this.canvas, { wide, tall, title: named(map), colours: { shade: values.shade, limits, words } });
  }

  /**
   * Draw where the slice cuts the sheet, from A to B.
   * @param {CanvasRenderingContext2D} pen of the canvas
   */
  drawTrace(pen) {
    if (!trace.length) return;
    for (const [colour, size] of /** @type {[string, number][]} */ ([["#fff", 3], ["#c22", 1.6]])) {
      pen.fillStyle = colour;
      for (const i of trace) {
        const [x, y] = this.screen(xOf(i % grid.cols), yOf(Math.floor(i / grid.cols)));
        pen.fillRect(x - size / 2, y - size / 2, size, size);
      }
    }
    pen.font = "bold 13px sans-serif"; pen.lineJoin = "round"; pen.lineWidth = 3; pen.strokeStyle = "#fff"; pen.fillStyle = "#c22";
    for (const [letter, i] of /** @type {[string, number][]} */ ([["A", trace.first], ["B", trace.last]])) {
      const [x, y] = this.screen(xOf(i % grid.cols), yOf(Math.floor(i / grid.cols)));
      /** @type {[number, number]} */
      const here = [clamp(x - 4, 2, this.size[0] - 12), clamp(y - 6, 12, this.size[1] - 4)];
      pen.strokeText(letter, ...here); pen.fillText(letter, ...here);
    }
  }

  /**
   * Place on the screen of a place of the map.
   * @param {number} x in um
   * @param {number} y in um
   * @returns {[number, number]}
   */
  screen(x, y) { return [(x - view.x) / view.um + this.size[0] / 2, (y - view.y) / view.um + this.size[1] / 2]; }

  /**
   * Place of the map of a place on the screen.
   * @param {Place} at on the screen
   * @returns {[number, number]} in um
   */
  um([right, down]) { return [view.x + (right - this.size[0] / 2) * view.um, view.y + (down - this.size[1] / 2) * view.um]; }

  /**
   * Bring the cursor to a place on the screen.
   * @param {Place} place on the screen
   */
  go(place) {
    const [x, y] = this.um(place);
    moveTo(Math.round((y - grid.y0) / grid.dy), Math.round((x - grid.x0) / grid.dx));
  }

  /**
   * A region while it is dragged.
   * @param {number[]} from where the drag began, in um
   * @returns {Held}
   */
  region([x0, y0]) {
    const move = (to) => {
      const [x, y] = this.um(to);
      this.drag = [Math.min(x, x0), Math.min(y, y0), Math.max(x, x0), Math.max(y, y0)];
      redraw("window");
    };
    const cancel = () => { this.drag = null; redraw("window"); };
    return { move, cancel, end: (to) => { move(to); setRegion(this.drag); cancel(); } };
  }

  /**
   * A key of the view.
   * @param {KeyboardEvent} event the key
   */
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

  /** By keys: the first Enter sets a corner, the second one the other. */
  corner() {
    const here = [xOf(state.col), yOf(state.row)], first = this.first;
    this.first = first ? null : here;
    if (first) setRegion([Math.min(first[0], here[0]), Math.min(first[1], here[1]), Math.max(first[0], here[0]), Math.max(first[1], here[1])]);
    else at("selection").textContent = "First corner of the region set. Move the cursor and press Enter again.";
  }
}

/**
 * Zoom both maps about a place.
 * @param {number} factor above 1 comes closer; 0 shows the whole map
 * @param {number[]} [around] (x, y) in um; the cursor where it is not given
 */
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

/**
 * Keep the cursor in the window when keys move it.
 * @param {number[]} size width and height of the window, in CSS pixels
 */
function follow(size) {
  const [x, y] = [xOf(state.col), yOf(state.row)], reach = [0.45 * size[0] * view.um, 0.45 * size[1] * view.um];
  if (view.um >= views[0].whole) return;
  view.x = clamp(view.x, x - reach[0], x + reach[0]);
  view.y = clamp(view.y, y - reach[1], y + reach[1]);
  redraw("window");
}

// The slice next to the cursor, its top side up: the whole of it, and magnified around the cursor.
/** @type {number[] & {first?: number, last?: number}} pixels of the map that the slice cuts, and those at its ends */
const trace = [];
const NEAR = 320; // um

class SliceView {
  /** Make the view. */
  constructor() {
    this.frame = at("slice");
    this.pictures = new Map();
    this.k = -1;
    this.frame.addEventListener("pointerdown", (event) => this.pressed(event));
    this.frame.addEventListener("keydown", (event) => this.key(event));
    const whole = at("slice-whole"), svg = () => svgOf(at("slice-near"), { wide: whole.clientWidth, tall: at("slice-near").clientHeight, title: at("slice-position").textContent });
    this.frame.before(viewBar("Slice", { svg }));
  }

  /** Take the sheet of the left map, or else of the right one, or else the first. */
  choose() {
    const wanted = sides.map((side) => data.groups[shown(side).group].sheet).find(Boolean) || data.stacks[0].sheet;
    this.stack = data.stacks.find((one) => one.sheet === wanted);
    this.group = data.groups.find((one) => one.sheet === wanted);
    at("slices").hidden = !this.stack;
  }

  /** Take the slice nearest to the cursor, or none where that lies beside the sheet. */
  seek() {
    const before = `${this.k} ${this.stack?.sheet}`;
    this.here = volumeAt(this.group);
    this.k = -1;
    if (this.here && this.stack) {
      const places = this.stack.at, wanted = this.here[this.stack.rows];
      const spacing = places.length > 1 ? Math.abs(places[1] - places[0]) : Infinity;
      let best = 0;
      for (let k = 1; k < places.length; k++) if (Math.abs(places[k] - wanted) < Math.abs(places[best] - wanted)) best = k;
      this.k = best;
      this.far = Math.abs(places[best] - wanted) > spacing;
    }
    if (before !== `${this.k} ${this.stack?.sheet}`) this.cut();
  }

  /** Find the pixels of the map that the slice cuts. */
  cut() {
    trace.length = 0;
    if (this.k < 0) return;
    const p = this.group.places[this.stack.rows], q = this.group.places[this.stack.cols], level = this.stack.at[this.k];
    const codes = p.codes, high = (i) => p.low + p.step * (codes[i] - 2) >= level;
    let low = Infinity, most = -Infinity;
    for (let row = 0, i = 0; row < grid.rows; row++) {
      for (let col = 0; col < grid.cols; col++, i++) {
        if (!codes[i]) continue;
        const own = high(i), right = col + 1 < grid.cols && codes[i + 1], under = row + 1 < grid.rows && codes[i + grid.cols];
        if (!(right && high(i + 1) !== own) && !(under && high(i + grid.cols) !== own)) continue;
        trace.push(i);
        const along = valueOf(q, q.codes[i]);
        if (along < low) { low = along; trace.first = i; }
        if (along > most) { most = along; trace.last = i; }
      }
    }
  }

  /**
   * The picture of a slice, asked for once.
   * @param {number} k from the first one
   * @returns {any} an image, with `ready` once it can be drawn
   */
  picture(k) {
    const stack = this.stack, key = `${stack.sheet} ${k}`;
    if (!this.pictures.has(key)) {
      const image = /** @type {any} */ (new Image()), all = stack.text || (stack.text = text(stack.pictures));
      image.onload = () => { image.ready = true; if (k === this.k) redraw("slice"); };
      image.src = `data:image/${stack.kind};base64,${all.slice(k ? stack.ends[k - 1] : 0, stack.ends[k])}`;
      this.pictures.set(key, image);
      if (this.pictures.size > 60) this.pictures.delete(this.pictures.keys().next().value);
    }
    return this.pictures.get(key);
  }

  /** Draw the slice twice: the whole of it, and magnified around the cursor. */
  draw() {
    const stack = this.stack;
    if (!stack) return;
    const wide = this.frame.clientWidth, um = stack.size[0] / wide;
    const tall = Math.max(stack.size[1] / um, 40);
    this.higher = tall / (stack.size[1] / um);
    const near = Math.min(NEAR * Math.max(1, wide / 480), stack.size[0]), nearTall = clamp((wide * Math.min(stack.size[1], 0.42 * near)) / near, 60, 330);
    const along = this.here ? this.here[stack.cols] : NaN, height = this.here ? stack.sign * this.here[stack.through] : NaN;
    const left = stack.start, top = this.k < 0 ? 0 : stack.top[this.k];
    const first = clamp(along - near / 2, left, left + stack.size[0] - near);
    const nearUm = near / wide, up = clamp(height + (nearTall * nearUm) / 2, top - stack.size[1] + nearTall * nearUm, Math.max(top, top - stack.size[1] + nearTall * nearUm));
    this.windows = [
      this.drawOne(at("slice-whole"), tall, { left, top, across: um, down: stack.size[1] / tall }, along, height, [first, first + near]),
      this.drawOne(at("slice-near"), Math.round(nearTall), { left: first, top: up, across: nearUm, down: nearUm }, along, height, null),
    ];
    at("slice-near").style.marginTop = "6px";
    this.tell();
    for (const k of [this.k - 1, this.k + 1]) if (this.k >= 0 && k >= 0 && k < stack.at.length) this.picture(k);
  }

  /**
   * Draw one of both pictures.
   * @param {HTMLCanvasElement} canvas where it is drawn
   * @param {number} tall its height in CSS pixels
   * @param {SliceWindow} window what it shows
   * @param {number} along place of the cursor, um along the slice
   * @param {number} height place of the cursor, um upwards
   * @param {number[]|null} near what the other picture shows, um along the slice
   * @returns {SliceWindow} what it shows
   */
  drawOne(canvas, tall, window, along, height, near) {
    const [pen, w, h] = prepared(canvas, tall), stack = this.stack;
    if (this.k < 0) { pen.fillStyle = "#cfd4d8"; pen.font = "13px sans-serif"; pen.fillText("The cursor lies beside the sheet.", 12, 22); return window; }
    const x = (um) => (um - window.left) / window.across, y = (um) => (window.top - um) / window.down;
    const image = this.picture(this.k);
    if (image.ready) pen.drawImage(image, x(stack.start), y(stack.top[this.k]), stack.size[0] / window.across, stack.size[1] / window.down);
    const used = stack.used, [begin, pitch] = stack.points;
    for (const line of data.lines) {
      const map = stack.lines[line.name];
      if (!map) continue;
      pen.strokeStyle = line.colour; pen.lineWidth = line.name === "centre" ? 1 : 1.6;
      for (const counted of line.name === "centre" ? [null] : [0, 1]) {
        pen.globalAlpha = counted === 0 ? 0.45 : 1;
        pen.setLineDash(line.dash ? line.dash.split(" ").map(Number) : []);
        pen.beginPath();
        let on = false;
        for (let c = 0, i = this.k * map.cols; c < map.cols; c++, i++) {
          const show = map.codes[i] && (counted === null || (used.codes[i] > 0) === (counted === 1));
          if (show) { const px = x(begin + c * pitch), py = y(valueOf(map, map.codes[i])); if (on) pen.lineTo(px, py); else pen.moveTo(px, py); }
          on = Boolean(show);
        }
        pen.stroke();
      }
    }
    pen.globalAlpha = 1;
    pen.setLineDash([]);
    if (near) { pen.strokeStyle = "#ff3b30"; pen.lineWidth = 1.4; pen.strokeRect(x(near[0]) + 0.7, 0.7, (near[1] - near[0]) / window.across - 1.4, h - 1.4); }
    pen.strokeStyle = "#fff"; pen.lineWidth = 1;
    pen.beginPath(); pen.moveTo(x(along), 0); pen.lineTo(x(along), h); pen.stroke();
    pen.beginPath(); pen.arc(x(along), y(height), 4, 0, 7); pen.stroke();
    pen.font = "bold 13px sans-serif"; pen.fillStyle = "#fff";
    if (near) { pen.fillText("A", 4, 14); pen.fillText("B", w - 14, 14); }
    drawScaleBar(pen, 10, h - 8, Math.min(w / 4, 140), window.across, "#fff", "#000");
    return window;
  }

  /** Say where the cursor lies in the volume, and which slice is shown. */
  tell() {
    const stack = this.stack, said = at("slice-position");
    if (this.k < 0) { said.textContent = "The cursor lies beside the sheet."; return; }
    const words = ["x", "y", "z"].map((axis) => `${axis} ${place(this.here[axis])}`).join(", ");
    const off = stack.at[this.k] - this.here[stack.rows];
    said.textContent = `${words} µm in the volume${data.several ? ` of ${stack.sheet}` : ""}; slice ${this.k + 1} of ${stack.at.length}, at ${stack.rows} = ${place(stack.at[this.k])} µm` +
      `${Math.abs(off) >= 0.05 ? `, ${place(Math.abs(off))} µm beside the cursor` : ""}${this.far ? ". No slice is nearer" : ""}.${this.higher > 1.01 ? ` Heights of the upper picture are drawn ${fixed(this.higher, 1)} times too large.` : ""}`;
  }

  /**
   * Bring the cursor to a place of the slice.
   * @param {number} across um, where the slice is cut
   * @param {number} along um along the slice
   */
  go(across, along) {
    const i = pixelOf(this.group, this.stack, across, along);
    if (i >= 0) { state.held = true; moveTo(Math.floor(i / grid.cols), i % grid.cols); }
  }

  /**
   * A press brings the cursor there.
   * @param {PointerEvent} event the press
   */
  pressed(event) {
    if (this.k < 0 || event.button) return;
    const canvas = /** @type {Element} */ (event.target), near = canvas.id === "slice-near" ? 1 : 0;
    const box = canvas.getBoundingClientRect(), window = this.windows[near];
    this.go(this.stack.at[this.k], window.left + (event.clientX - box.left) * window.across);
  }

  /**
   * A key of the view.
   * @param {KeyboardEvent} event the key
   */
  key(event) {
    if (this.k < 0) return;
    const stack = this.stack, many = event.shiftKey ? 10 : 1, pitch = Math.max(grid.dx, grid.dy), along = this.here[stack.cols];
    const side = { ArrowLeft: -1, ArrowRight: 1 }[event.key], next = { ArrowUp: -1, ArrowDown: 1 }[event.key];
    if (side) this.go(stack.at[this.k], along + side * many * pitch);
    else if (next) this.go(stack.at[clamp(this.k + next * many, 0, stack.at.length - 1)], along);
    else return;
    event.preventDefault();
  }
}

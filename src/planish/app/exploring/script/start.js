// The page comes to life: data unpacked, fields joined to the views, everything drawn once a frame.
let views = [], scatter = null, slice = null, due = new Set(), waiting = false;

/**
 * Have something drawn with the next frame.
 * @param {string} what what has changed: "choice" (layers, brushes or regions), "colours", "window", "cursor" or
 *   "slice"
 */
function redraw(what) {
  due.add(what);
  if (!waiting) { waiting = true; requestAnimationFrame(drawDue); }
}

/** Draw what has changed since the last frame. */
function drawDue() {
  const what = due;
  due = new Set();
  waiting = false;
  if (what.has("choice")) { choose(); showPoints(); tellSelection(); }
  if (what.has("choice") || what.has("colours")) for (const one of views) one.paint();
  if (slice && (what.has("cursor") || what.has("choice"))) slice.seek();
  for (const one of views) one.draw();
  if (what.has("cursor")) { scatter.here = sides.map((side) => valueOf(shown(side), shown(side).codes[state.row * grid.cols + state.col])); scatter.draw(); }
  if (slice) slice.draw();
  if (what.has("cursor") || what.has("choice")) tellCursor();
}

/** Show the scatter of both maps. */
function showPoints() {
  scatter.brush = sides.map((side) => state.brush[side]);
  const withheld = doubtOf(state.left, state.right)?.trust === "withheld";
  scatter.show(withheld ? null : pointsOf(shown("left"), shown("right")), withheld ? "Withheld by the checks; not drawn." : "");
}

/**
 * Bring the cursor to a pixel.
 * @param {number} row clipped to the map
 * @param {number} col clipped to the map
 */
function moveTo(row, col) {
  const found = [clamp(row, 0, grid.rows - 1), clamp(col, 0, grid.cols - 1)];
  if (found[0] === state.row && found[1] === state.col) return;
  [state.row, state.col] = found;
  redraw("cursor");
}

/** Say what lies at the cursor. */
function tellCursor() {
  const i = state.row * grid.cols + state.col, [x, y] = grid.names;
  const parts = [`${x} ${place(xOf(state.col))}, ${y} ${place(yOf(state.row))} µm`];
  data.maps.forEach((map, k) => {
    const value = written(map, map.codes[i]), cell = map.row.lastChild;
    cell.firstChild.nodeValue = map.units === "°" ? value : `${value} `;
    map.row.className = k === state.left || k === state.right ? "shown" : "";
  });
  for (const side of sides) {
    const map = shown(side), valid = data.groups[map.group].valid?.codes, value = written(map, map.codes[i]);
    const beside = map.codes[i] && valid && !valid[i] ? ", does not count here" : "";
    const doubt = map.trust === "ok" ? "" : `, ${map.trust} (${map.why.join(", ")})`;
    const measure = map.codes[i] ? `${value} ${map.units}`.trim().replace(" °", "°") : "no value";
    at(`${side}-value`).textContent = `${map.codes[i] ? measure : "No value here"}${beside}${doubt}`;
    parts.push(`${named(map)} ${measure}${beside}${doubt}`);
  }
  for (const group of data.groups) {
    if (!group.sheet) continue;
    const found = volumeAt(group);
    parts.push(`volume${data.several ? ` of ${group.sheet}` : ""} ${found ? ["x", "y", "z"].map((axis) => `${axis} ${place(found[axis])}`).join(", ") + " µm" : "–"}`);
  }
  at("cursor").textContent = `${parts.join("; ")}${state.held ? " (held)" : ""}`;
}

/**
 * Pick the pixels of a region.
 * @param {number[]|null} box x0, y0, x1, y1 in um; null picks all
 */
function setRegion(box) {
  state.region = box;
  at("region").value = box ? box.map((v) => v.toFixed(1)).join(", ") : "";
  at("message").textContent = "";
  redraw("choice");
}

/**
 * Pick the pixels of some values.
 * @param {number[]|null} left low and high of the left map; null picks all
 * @param {number[]|null} right low and high of the right map; null picks all
 */
function setBrush(left, right) {
  state.brush = { left, right };
  sides.forEach((side) => {
    const limits = state.brush[side];
    at(`brush-${side}`).value = limits ? limits.map((v) => v.toFixed(Math.max(shown(side).digits, 0))).join(", ") : "";
  });
  at("message").textContent = "";
  redraw("choice");
}

/** Pick nothing: neither a region nor values. */
function clearSelection() {
  for (const one of views) one.first = null;
  setRegion(null);
  setBrush(null, null);
}

/**
 * Let a field of numbers do something.
 * @param {string} id its id
 * @param {number} many how many numbers it takes
 * @param {(found: number[]|null) => void} use gets them; null where it is empty
 */
function field(id, many, use) {
  const say = (words) => { at("message").textContent = words; };
  const refuse = () => say(`${at(id).placeholder}: ${many} numbers are needed.`);
  onNumbers(at(id), { count: many, refuse, use: (found) => { say(""); use(found); } });
}

/** Make the views, and let fields and keys work on them. */
function join() {
  views = sides.map((side) => new MapView(side));
  const ramp = (share) => { const k = 3 * Math.round(254 * share); return data.ramp.subarray(k, k + 3); };
  scatter = new Scatter({ element: at("scatter"), shade: ramp, onBrush: setBrush, onClear: clearSelection });
  scatter.canvas.id = "scatter-plot";
  at("scatter").before(scatter.bar);
  slice = data.stacks.length ? new SliceView() : null;
  at("slices").hidden = !slice;
  sides.forEach((side) => {
    const box = at(`${side}-layer`);
    box.replaceChildren(...data.maps.map((map, i) => new Option(named(map) + (map.trust === "ok" ? "" : ` (${map.trust})`), i)));
    box.value = state[side];
    box.addEventListener("change", () => { state[side] = Number(box.value); chosen(); });
    field(`brush-${side}`, 2, (found) => {
      const brush = { ...state.brush, [side]: found && [Math.min(...found), Math.max(...found)] };
      setBrush(brush.left, brush.right);
    });
  });
  field("region", 4, (found) => setRegion(found && [Math.min(found[0], found[2]), Math.min(found[1], found[3]), Math.max(found[0], found[2]), Math.max(found[1], found[3])]));
  at("clear").addEventListener("click", clearSelection);
  document.addEventListener("keydown", (event) => {
    if (event.key === "?" && !/** @type {Element} */ (event.target).matches("input")) { at("keys").open = !at("keys").open; at("keys").scrollIntoView({ block: "nearest" }); }
  });
  at("values").replaceChildren(...data.maps.map((map) => {
    const row = document.createElement("tr"), name = document.createElement("th"), cell = document.createElement("td"), unit = document.createElement("small");
    name.scope = "row"; name.textContent = named(map) + (map.trust === "ok" ? "" : ` (${map.trust})`);
    unit.textContent = map.units; cell.append("", unit); row.append(name, cell);
    map.row = row;
    return row;
  }));
  for (const line of slice ? data.lines.filter((one) => data.stacks.some((stack) => stack.lines[one.name])) : []) {
    const item = document.createElement("li"), key = document.createElement("canvas"), pen = key.getContext("2d");
    [key.width, key.height] = [26, 8];
    pen.strokeStyle = line.colour; pen.lineWidth = 2; pen.setLineDash(line.dash ? line.dash.split(" ").map(Number) : []);
    pen.moveTo(0, 4); pen.lineTo(26, 4); pen.stroke();
    item.append(key, line.title);
    at("slice-lines").append(item);
  }
  let wide = 0;
  new ResizeObserver(([entry]) => {
    if (entry.contentRect.width === wide) return;
    wide = entry.contentRect.width; view.um = 0; redraw("window");
  }).observe(document.querySelector("main"));
  matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => { readColours(); redraw("choice"); });
}

/** Other layers were chosen: brushes were of the old ones. */
function chosen() {
  sides.forEach((side, k) => {
    views[k].choose();
    at(`brush-${side}-label`).textContent = `Brush ${named(shown(side))}`;
  });
  slice?.choose();
  setBrush(null, null);
  redraw("cursor");
}

/** Bring the cursor to the pixel that counts next to the middle. */
function begin() {
  let best = Infinity;
  const middle = [grid.rows >> 1, grid.cols >> 1];
  for (let i = 0; i < pixels; i++) {
    if (!state.chosen[i]) continue;
    const row = Math.floor(i / grid.cols), col = i % grid.cols, d = Math.hypot(row - middle[0], col - middle[1]);
    if (d < best) { best = d; state.row = row; state.col = col; }
  }
}

/**
 * Unpack the maps, and show them.
 * @returns {Promise<void>}
 */
async function start() {
  const began = performance.now();
  for (const [name, shades] of Object.entries(data.palettes)) data.palettes[name] = bytesOf(shades);
  const found = await Promise.all(data.maps.map(unpack));
  found.forEach((one, k) => { data.maps[k] = Object.assign(one, { palette: data.palettes[one.colours] }, axisOf(one)); });
  data.ramp = data.palettes[data.maps[0].colours];
  for (const group of data.groups) {
    if (group.valid) group.valid = await unpack(group.valid);
    for (const axis of Object.keys(group.places)) group.places[axis] = await unpack(group.places[axis]);
  }
  for (const stack of data.stacks) {
    stack.used = await unpack(stack.used);
    for (const name of Object.keys(stack.lines)) stack.lines[name] = await unpack(stack.lines[name]);
  }
  readColours();
  at("still").hidden = true;
  at("desk").hidden = false;
  join();
  choose();
  begin();
  chosen();
  drawDue();
  document.documentElement.dataset.ready = String(Math.round(performance.now() - began));
}

if (typeof DecompressionStream === "undefined" || typeof ResizeObserver === "undefined") {
  at("why").textContent = "This browser is too old for this page: it cannot unpack the maps. Open the file in Chrome or Edge from version 80, Firefox from 113, or Safari from 16.4.";
} else {
  start().catch((error) => {
    at("desk").hidden = true;
    at("still").hidden = false;
    at("why").textContent = `The maps of this page could not be unpacked (${error.message}). The file may be damaged: copy it again.`;
  });
}

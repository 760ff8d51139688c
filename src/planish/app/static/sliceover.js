/** What is drawn over the pixels of a slice: faces, normals, errors, points, the cursor. */

/** @import {SliceView} from "./sliceview.js" */

/** Colours as in the report: they need no red and green to be told apart. */
export const LINES = [
  ["top", "Top face", "#ffb000"],
  ["interface_top", "Interface, top side", "#39c5ff"],
  ["centre", "Centre surface", "#ffffff"],
  ["interface_bottom", "Interface, bottom side", "#4f8bff"],
  ["bottom", "Bottom face", "#ff5fa2"],
];
export const PREVIEW = "#7dff6a";
const FOUND = "#b9b9b9";

/**
 * Draw all that a view shows.
 * @param {SliceView} view the view
 * @param {CanvasRenderingContext2D} pen of its canvas
 */
export function drawOver(view, pen) {
  if (view.shown.has("normals")) drawNormals(view, pen);
  if (view.shown.has("error")) drawErrors(view, pen);
  if (view.shown.has("before")) drawFound(view, pen);
  for (const [name, , colour] of LINES) {
    const kind = name === "centre" ? "centre" : name.startsWith("interface") ? "interfaces" : "faces";
    if (!view.shown.has(kind)) continue;
    drawLine(view, pen, name, colour, name === "centre" ? [7, 4] : []);
    drawContour(view, pen, name, colour);
  }
  for (const face of ["preview_top", "preview_bottom"]) drawLine(view, pen, face, PREVIEW, [], true);
  drawPoints(view, pen);
  drawCursor(view, pen);
  if (view.marked) drawCross(pen, view.onScreen(view.marked.across, view.marked.down));
}

/**
 * Draw a face; pale where it was not measured.
 * @param {SliceView} view the view
 * @param {CanvasRenderingContext2D} pen of its canvas
 * @param {string} name that of the line
 * @param {string} colour of the line
 * @param {number[]} dash lengths of dashes and gaps
 * @param {boolean} [onlyChanged] only where it differs from the face that was found
 */
function drawLine(view, pen, name, colour, dash, onlyChanged = false) {
  const { slice } = view;
  const line = slice?.lines.get(name);
  if (!slice || !line || !slice.facts.columns) return;
  const { first_um: first, step_um: step } = slice.facts.columns;
  const status = slice.lines.get("status");
  const usual = onlyChanged ? slice.lines.get(name.replace("preview_", "")) : null;
  pen.lineWidth = onlyChanged ? 2 : 1.5;
  pen.strokeStyle = colour;
  pen.setLineDash(dash);
  for (const measured of [false, true]) {
    pen.globalAlpha = measured ? 1 : 0.45;
    pen.beginPath();
    let open = false;
    line.forEach((height, k) => {
      const fits = onlyChanged ? measured : !status || (status[k] === 0) === measured;
      if (!Number.isFinite(height) || !fits || (usual && Math.abs(usual[k] - height) < 1e-3)) {
        open = false;
        return;
      }
      const [x, y] = view.onScreen(first + k * step, height);
      if (open) pen.lineTo(x, y);
      else pen.moveTo(x, y);
      open = true;
    });
    pen.stroke();
  }
  pen.globalAlpha = 1;
  pen.setLineDash([]);
}

/**
 * Draw where a face cuts a slice along the sheet.
 * @param {SliceView} view the view
 * @param {CanvasRenderingContext2D} pen of its canvas
 * @param {string} name that of the face
 * @param {string} colour of the line
 */
function drawContour(view, pen, name, colour) {
  const segments = view.slice?.contours.get(name);
  if (!segments) return;
  pen.strokeStyle = colour;
  pen.lineWidth = 1.5;
  pen.beginPath();
  for (let k = 0; k < segments.length; k += 4) {
    pen.moveTo(...view.onScreen(segments[k], segments[k + 1]));
    pen.lineTo(...view.onScreen(segments[k + 2], segments[k + 3]));
  }
  pen.stroke();
}

/**
 * Draw the faces as they were before corrections.
 * @param {SliceView} view the view
 * @param {CanvasRenderingContext2D} pen of its canvas
 */
function drawFound(view, pen) {
  for (const face of ["top", "bottom"]) drawLine(view, pen, `found_${face}`, FOUND, [2, 3]);
}

/**
 * Every so many columns that two lie at least so many screen pixels apart.
 * @param {SliceView} view the view
 * @param {number} apart in screen pixels
 * @returns {number}
 */
function everyColumn(view, apart) {
  const columns = view.slice?.facts.columns;
  return columns ? Math.max(1, Math.ceil(apart / (Math.abs(columns.step_um) * view.zoom))) : 1;
}

/**
 * Normals of the centre surface, from face to face.
 * @param {SliceView} view the view
 * @param {CanvasRenderingContext2D} pen of its canvas
 */
function drawNormals(view, pen) {
  const { slice } = view;
  const columns = slice?.facts.columns;
  const [top, bottom, centre] = ["top", "bottom", "centre"].map((name) => slice?.lines.get(name));
  if (!slice || !columns || !top || !bottom || !centre) return;
  const straight = slice.facts.direction === "straight";
  const name = view.acrossIsRows ? "normal_rows" : "normal_cols";
  const [sideways, through] = [slice.lines.get(name), slice.lines.get("normal_through")];
  if (!sideways || !through) return;
  pen.strokeStyle = "#ffffff";
  pen.lineWidth = 1;
  pen.beginPath();
  for (let k = 0; k < columns.count; k += everyColumn(view, 18)) {
    if (!Number.isFinite(top[k] + bottom[k] + centre[k] + sideways[k])) continue;
    const at = columns.first_um + k * columns.step_um;
    for (const face of [top[k], bottom[k]]) {
      const length = straight ? face : (face - centre[k]) / through[k];
      pen.moveTo(...view.onScreen(at, centre[k]));
      pen.lineTo(
        ...view.onScreen(straight ? at : at + length * sideways[k], straight ? face : centre[k] + length * through[k]),
      );
    }
  }
  pen.stroke();
}

/**
 * One standard error of the thickness at each face.
 * @param {SliceView} view the view
 * @param {CanvasRenderingContext2D} pen of its canvas
 */
function drawErrors(view, pen) {
  const { slice } = view;
  const columns = slice?.facts.columns;
  const error = slice?.lines.get("thickness_se");
  if (!slice || !columns || !error) return;
  pen.strokeStyle = "#ff8d7a";
  pen.lineWidth = 1;
  pen.beginPath();
  for (const name of ["top", "bottom"]) {
    const line = slice.lines.get(name);
    for (let k = 0; line && k < columns.count; k += everyColumn(view, 6)) {
      if (!Number.isFinite(line[k] + error[k])) continue;
      const at = columns.first_um + k * columns.step_um;
      pen.moveTo(...view.onScreen(at, line[k] - error[k]));
      pen.lineTo(...view.onScreen(at, line[k] + error[k]));
    }
  }
  pen.stroke();
}

/**
 * Draw the points of corrections.
 * @param {SliceView} view the view
 * @param {CanvasRenderingContext2D} pen of its canvas
 */
function drawPoints(view, pen) {
  for (const point of view.points) {
    const [x, y] = view.onScreen(point.across, point.down);
    pen.globalAlpha = point.here ? 1 : 0.4;
    pen.lineWidth = 3;
    pen.strokeStyle = "#000";
    pen.beginPath();
    pen.arc(x, y, 5, 0, 7);
    pen.stroke();
    pen.lineWidth = 1.5;
    pen.strokeStyle = point.draft ? PREVIEW : "#fff";
    pen.stroke();
  }
  pen.globalAlpha = 1;
}

/**
 * Draw the cursor of the keys.
 * @param {SliceView} view the view
 * @param {CanvasRenderingContext2D} pen of its canvas
 */
function drawCursor(view, pen) {
  if (!view.cursor || document.activeElement !== view.canvas || !view.canvas.matches(":focus-visible")) return;
  drawCross(pen, [view.cursor.x, view.cursor.y]);
}

/**
 * Draw a cross with an open middle.
 * @param {CanvasRenderingContext2D} pen where it is drawn
 * @param {number[]} at on the screen
 */
function drawCross(pen, [x, y]) {
  for (const [colour, width] of /** @type {[string, number][]} */ ([["#000", 3], ["#fff", 1]])) {
    pen.strokeStyle = colour;
    pen.lineWidth = width;
    pen.beginPath();
    pen.moveTo(x - 11, y);
    pen.lineTo(x - 3, y);
    pen.moveTo(x + 3, y);
    pen.lineTo(x + 11, y);
    pen.moveTo(x, y - 11);
    pen.lineTo(x, y - 3);
    pen.moveTo(x, y + 3);
    pen.lineTo(x, y + 11);
    pen.stroke();
  }
}

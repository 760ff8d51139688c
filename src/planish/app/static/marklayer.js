/** Marks and holes drawn over a map view; they are picked and dragged here. */

import { flipped } from "./mapview.js";

/**
 * @import {Point} from "./geometry.js"
 * @import {Place} from "./gestures.js"
 * @import {MapView} from "./mapview.js"
 * @import {Mark, MarkId, Side} from "./store.js"
 */

/* global ol */

/** How near, in screen pixels, a mark is taken to be meant. */
const NEAR_PX = 9;

/** Each colour has a dark and a light line, so that it is seen on any picture. */
const COLOURS = { mark: "#ffd23f", chosen: "#ff5fa2", unused: "#d5d9dd", hole: "#6fd3ff", ghost: "#ffffff" };
const HALO = "rgba(0, 0, 0, 0.75)";

/**
 * A line as two strokes, dark and light.
 * @param {string} colour of the light one
 * @param {number} width in screen pixels
 * @param {number[]} [dash] lengths of dashes and gaps
 * @returns {any[]} strokes of OpenLayers
 */
const strokes = (colour, width, dash) => [
  new ol.style.Stroke({ color: HALO, width: width + 2 }),
  new ol.style.Stroke({ color: colour, width, lineDash: dash }),
];

/**
 * Two strokes, dark and light, of a cross with an open middle.
 * @param {string} colour of the light one
 * @param {number} radius in screen pixels
 * @returns {any[]} styles of OpenLayers
 */
function cross(colour, radius) {
  return strokes(colour, 1.6).map(
    (stroke) => new ol.style.Style({ image: new ol.style.RegularShape({ points: 4, radius, radius2: 0, stroke }) }),
  );
}

/**
 * Two strokes, dark and light, of a ring.
 * @param {string} colour of the light one
 * @param {number} radius in screen pixels
 * @param {number} width in screen pixels
 * @param {number[]} [dash] lengths of dashes and gaps
 * @returns {any[]} styles of OpenLayers
 */
function ring(colour, radius, width, dash) {
  return strokes(colour, width, dash).map(
    (stroke) => new ol.style.Style({ image: new ol.style.Circle({ radius, stroke }) }),
  );
}

/**
 * A tile of texture.
 * @param {string} colour of the light line
 * @param {boolean} used whether the fit uses it; dashed where not
 * @returns {any[]} styles of OpenLayers
 */
const square = (colour, used) =>
  strokes(colour, 1.6, used ? undefined : [3, 3]).map(
    (stroke) => new ol.style.Style({ image: new ol.style.RegularShape({ points: 4, radius: 11, angle: Math.PI / 4, stroke }) }),
  );

/**
 * The name beside a mark.
 * @param {string} text what is written
 * @param {string} colour of the letters
 * @returns {any} style of OpenLayers
 */
function name(text, colour) {
  const label = new ol.style.Text({
    text,
    font: "600 13px system-ui, sans-serif",
    offsetX: 12,
    offsetY: -12,
    textAlign: "left",
    fill: new ol.style.Fill({ color: colour }),
    stroke: new ol.style.Stroke({ color: HALO, width: 3 }),
  });
  return new ol.style.Style({ text: label });
}

const HOLE = strokes(COLOURS.hole, 1).map((stroke) => new ol.style.Style({ stroke }));
const GHOST = [...ring(COLOURS.ghost, 9, 1.4, [4, 3]), ...cross(COLOURS.ghost, 5)];

/**
 * How a mark is drawn.
 * @param {any} feature of OpenLayers, with the properties that `showMarks` gives it
 * @returns {any[]} styles of OpenLayers
 */
function markStyle(feature) {
  const { label, used, chosen, tile } = feature.getProperties();
  const colour = chosen ? COLOURS.chosen : used ? COLOURS.mark : COLOURS.unused;
  const shape = tile ? square(colour, used) : used ? cross(colour, 9) : ring(colour, 6, 1.4, [3, 3]);
  const around = chosen ? ring(colour, 13, 2) : [];
  return [...shape, ...around, name(used ? label : `${label} (not used)`, colour)];
}

export class MarkLayer {
  /**
   * Make the layers of one view.
   * @param {MapView} view the view
   * @param {Side} side plane that it shows
   */
  constructor(view, side) {
    this.view = view;
    this.side = side;
    this.holes = this.addLayer(HOLE, 5);
    this.marks = this.addLayer(markStyle, 10);
    this.ghost = this.addLayer(GHOST, 15);
  }

  /**
   * Make a layer.
   * @param {any} style of OpenLayers
   * @param {number} zIndex a higher one lies above
   * @returns {any} source of OpenLayers
   */
  addLayer(style, zIndex) {
    const source = new ol.source.Vector();
    this.view.map.addLayer(
      new ol.layer.Vector({ source, style, zIndex, updateWhileAnimating: true, updateWhileInteracting: true }),
    );
    return source;
  }

  /**
   * Draw all holes of this side.
   * @param {number[][]} holes x, y and diameter in um
   */
  showHoles(holes) {
    const circles = holes.map(([x, y, diameter]) => new ol.geom.Circle(flipped([x, y]), diameter / 2));
    this.holes.clear();
    this.holes.addFeatures(circles.map((circle) => new ol.Feature(circle)));
  }

  /**
   * Draw the marks' ends on this side.
   * @param {Mark[]} marks those of the session
   * @param {MarkId|null} chosen the one that is chosen
   */
  showMarks(marks, chosen) {
    const ends = marks.filter((mark) => mark[this.side]);
    this.marks.clear();
    this.marks.addFeatures(
      ends.map((mark) => {
        const feature = new ol.Feature(new ol.geom.Point(flipped(mark[this.side])));
        feature.setProperties({ id: mark.id, label: mark.label, used: mark.used, chosen: mark.id === chosen, tile: mark.source.includes("tile") });
        return feature;
      }),
    );
  }

  /**
   * Draw where a point is predicted.
   * @param {Point|null} point (x, y) in um; null where there is no prediction
   */
  showGhost(point) {
    this.ghost.clear();
    if (point) this.ghost.addFeature(new ol.Feature(new ol.geom.Point(flipped(point))));
  }

  /**
   * The mark's end that a place on the screen means.
   * @param {Place} pixel on the screen
   * @returns {any} feature of OpenLayers; null where none is near
   */
  near(pixel) {
    let [best, found] = [NEAR_PX, null];
    for (const feature of this.marks.getFeatures()) {
      const at = this.view.map.getPixelFromCoordinate(feature.getGeometry().getCoordinates());
      const away = at ? Math.hypot(at[0] - pixel[0], at[1] - pixel[1]) : Infinity;
      if (away < best) [best, found] = [away, feature];
    }
    return found;
  }

  /**
   * Let a mark be dragged.
   * @param {(id: MarkId, point: Point) => void} onMove called while it is dragged
   * @param {(id: MarkId, point: Point) => void} onMoved called at the end
   */
  dragging(onMove, onMoved) {
    this.view.takes.push((at) => {
      const feature = this.near(at);
      if (!feature) return null;
      const id = feature.get("id");
      return {
        move: (to) => {
          feature.getGeometry().setCoordinates(flipped(this.view.pointAt(to)));
          onMove(id, this.view.pointAt(to));
        },
        end: (to) => onMoved(id, this.view.pointAt(to)),
      };
    });
  }
}

/** Region, line, artefacts and the cursor on both maps, as they stand and while they are drawn. */

import { flipped } from "./mapview.js";

/**
 * @import {Point} from "./geometry.js"
 * @import {Held, Place} from "./gestures.js"
 * @import {MapView} from "./mapview.js"
 */

/* global ol */

/**
 * A line on a white ground, and what it encloses.
 * @param {string} stroke colour of the line
 * @param {string} fill colour of the inside
 * @param {number[]} [dash] lengths of dashes and gaps
 * @returns {any[]} styles of OpenLayers
 */
const styled = (stroke, fill, dash = []) => [
  new ol.style.Style({ stroke: new ol.style.Stroke({ color: "#fff", width: 4 }) }),
  new ol.style.Style({
    stroke: new ol.style.Stroke({ color: stroke, width: 2, lineDash: dash }),
    fill: new ol.style.Fill({ color: fill }),
  }),
];

/**
 * A cross.
 * @param {string} color of its lines
 * @param {number} width in screen pixels
 * @returns {any} style of OpenLayers
 */
const cursor = (color, width) =>
  new ol.style.Style({
    image: new ol.style.RegularShape({ points: 4, radius: 13, radius2: 0, stroke: new ol.style.Stroke({ color, width }) }),
  });
const STYLES = {
  region: styled("#ff4800", "rgba(255, 72, 0, 0.08)"),
  line: styled("#0b5cad", "transparent"),
  artefact: styled("#7a1fa2", "rgba(122, 31, 162, 0.18)", [6, 4]),
  drawn: styled("#ff4800", "rgba(255, 72, 0, 0.08)", [4, 4]),
  cursor: [cursor("#fff", 4), cursor("#111", 1.6)],
};
const HOW = {
  Box: "Drag over the region, or click two corners.",
  LineString: "Drag along the line, or click both ends.",
  Polygon: "Click the corners; a click on the first one, or a double click, ends.",
};
/** How near the first or the last corner a click ends a polygon, in screen pixels. */
const NEAR_PX = 8;

export class Shapes {
  /**
   * Draw over both maps.
   * @param {MapView[]} views the maps
   * @param {object} on what is called
   * @param {(text: string) => void} on.say says how a shape is drawn
   * @param {(type: string, points: Point[]) => void} on.drawn gets two corners of a box, all of a polygon, or the ends
   *   of a line, in um
   */
  constructor(views, on) {
    this.views = views;
    this.on = on;
    /** What is being drawn */
    this.tool = null;
    this.points = [];
    this.source = new ol.source.Vector();
    for (const view of views) {
      const style = (feature) => STYLES[(feature.get("kind"))];
      view.map.addLayer(new ol.layer.Vector({ source: this.source, style, zIndex: 5 }));
      view.takes.push((at, shift) => (this.tool === "Polygon" || !(this.tool || shift) ? null : this.held(view, at)));
      view.hovers.push((point) => this.tool && this.points.length && point && this.sketch([...this.points, point]));
    }
  }

  /**
   * A box or a line while it is dragged.
   * @param {MapView} view map in which it is dragged
   * @param {Place} at where the drag began
   * @returns {Held}
   */
  held(view, at) {
    this.tool ??= "Box";
    const from = this.points[0] ?? view.pointAt(at);
    const ends = (to) => [from, view.pointAt(to)];
    return {
      move: (to) => this.sketch(ends(to)),
      end: (to) => this.finish(ends(to)),
      cancel: () => this.end(),
    };
  }

  /**
   * Draw a region.
   * @param {number[]|null} region x0, y0, x1, y1 in um
   */
  region(region) {
    const extent = region && [region[0], -region[3], region[2], -region[1]];
    this.show("region", extent ? [ol.geom.Polygon.fromExtent(extent)] : []);
  }

  /**
   * Draw a line.
   * @param {number[]|null} line x0, y0, x1, y1 in um
   */
  line(line) {
    this.show("line", line ? [new ol.geom.LineString([flipped(line.slice(0, 2)), flipped(line.slice(2))])] : []);
  }

  /**
   * Draw the artefacts.
   * @param {Point[][]} polygons corners of each, (x, y) in um
   */
  artefacts(polygons) {
    this.show("artefact", polygons.map((one) => new ol.geom.Polygon([one.map((point) => flipped(point))])));
  }

  /**
   * Draw the cursor.
   * @param {Point|null} point (x, y) in um
   */
  cursor(point) {
    this.show("cursor", point ? [new ol.geom.Point(flipped(point))] : []);
  }

  /**
   * Draw these geometries, and no others of their kind.
   * @param {string} kind a key of `STYLES`
   * @param {any[]} geometries of OpenLayers
   */
  show(kind, geometries) {
    const old = this.source.getFeatures().filter((one) => one.get("kind") === kind);
    for (const feature of old) this.source.removeFeature(feature);
    for (const geometry of geometries) this.source.addFeature(new ol.Feature({ geometry, kind }));
  }

  /**
   * Let a person draw in any of the maps.
   * @param {string} type a key of `HOW`
   */
  start(type) {
    this.end();
    this.tool = type;
    this.on.say(`${HOW[type]} By keys: Enter sets a corner at the cross in the middle. Esc cancels.`);
    this.views[0].element.focus();
  }

  /**
   * A corner that was clicked, or set by Enter.
   * @param {Point} point (x, y) in um
   * @param {MapView} view map in which it lies
   */
  corner(point, view) {
    const last = this.points.at(-1);
    const near = (corner) => corner && Math.hypot(point[0] - corner[0], point[1] - corner[1]) < NEAR_PX * view.pixel;
    const again = near(last) || (this.points.length > 2 && near(this.points[0]));
    if (!again) this.points.push(point);
    const enough = this.tool === "Polygon" ? again && this.points.length > 2 : this.points.length > 1;
    if (enough) this.finish(this.points);
    else this.sketch(this.points);
  }

  /**
   * Draw a shape that is not finished.
   * @param {Point[]} points so far, (x, y) in um
   */
  sketch(points) {
    const [first, last] = [points[0], points[points.length - 1]];
    const corners = this.tool === "Box" ? [first, [last[0], first[1]], last, [first[0], last[1]]] : points;
    const places = corners.map(flipped);
    this.show("drawn", [this.tool === "LineString" || places.length < 3 ? new ol.geom.LineString(places) : new ol.geom.Polygon([places])]);
  }

  /**
   * Hand over a shape.
   * @param {Point[]} points all, (x, y) in um
   */
  finish(points) {
    const type = this.tool;
    this.end();
    this.on.say("");
    this.on.drawn(type, points);
  }

  /** Draw no more. */
  end() {
    this.tool = null;
    this.points = [];
    this.show("drawn", []);
  }
}

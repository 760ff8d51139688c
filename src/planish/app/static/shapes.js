/** Region, line and artefacts on both maps, as they stand and while they are drawn. */

import { flipped } from "./mapview.js";

/* global ol */

const ACCENT = "#ff4800";
const styled = (/** @type {string} */ stroke, /** @type {string} */ fill, /** @type {number[]} */ dash = []) => [
  new ol.style.Style({ stroke: new ol.style.Stroke({ color: "#fff", width: 4 }) }),
  new ol.style.Style({
    stroke: new ol.style.Stroke({ color: stroke, width: 2, lineDash: dash }),
    fill: new ol.style.Fill({ color: fill }),
  }),
];
const STYLES = {
  region: styled(ACCENT, "rgba(255, 72, 0, 0.08)"),
  line: styled("#0b5cad", "transparent"),
  artefact: styled("#7a1fa2", "rgba(122, 31, 162, 0.18)", [6, 4]),
};
const HOW = {
  Box: "Click two corners of the region.",
  LineString: "Click both ends of the line.",
  Polygon: "Click the corners; a double click ends.",
};

export class Shapes {
  /**
   * @param {import("./mapview.js").MapView[]} views
   * @param {{say: (text: string) => void, drawn: (type: string, points: number[][]) => void}} on
   *   `drawn` gets the corners of a box or polygon, or the ends of a line, in um
   */
  constructor(views, on) {
    this.views = views;
    this.on = on;
    /** @type {any[]|null} */
    this.sketching = null;
    this.source = new ol.source.Vector();
    for (const { map } of views) {
      const style = (/** @type {any} */ feature) => STYLES[/** @type {keyof STYLES} */ (feature.get("kind"))];
      map.addLayer(new ol.layer.Vector({ source: this.source, style, zIndex: 5 }));
    }
  }

  /** @param {number[]|null} region x0, y0, x1, y1 in um */
  region(region) {
    const extent = region && [region[0], -region[3], region[2], -region[1]];
    this.show("region", extent ? [ol.geom.Polygon.fromExtent(extent)] : []);
  }

  /** @param {number[]|null} line x0, y0, x1, y1 in um */
  line(line) {
    this.show("line", line ? [new ol.geom.LineString([flipped(line.slice(0, 2)), flipped(line.slice(2))])] : []);
  }

  /** @param {number[][][]} polygons */
  artefacts(polygons) {
    this.show("artefact", polygons.map((one) => new ol.geom.Polygon([one.map((point) => flipped(point))])));
  }

  /** @param {string} kind @param {any[]} geometries what stands for it from now on */
  show(kind, geometries) {
    const old = this.source.getFeatures().filter((/** @type {any} */ one) => one.get("kind") === kind);
    for (const feature of old) this.source.removeFeature(feature);
    for (const geometry of geometries) this.source.addFeature(new ol.Feature({ geometry, kind }));
  }

  /** Let a person draw in any of the maps. @param {keyof HOW} type */
  sketch(type) {
    this.end();
    const box = { type: "Circle", geometryFunction: ol.interaction.Draw.createBox() };
    const how = { Box: box, LineString: { type, maxPoints: 2 }, Polygon: { type } }[type];
    this.sketching = this.views.map(({ map }) => {
      const draw = new ol.interaction.Draw(how);
      map.addInteraction(draw);
      draw.on("drawend", (/** @type {any} */ event) => setTimeout(() => this.sketched(type, event.feature.getGeometry())));
      return draw;
    });
    this.on.say(`${HOW[type]} Esc in a map leaves it.`);
    this.views[0].element.focus();
  }

  /** @param {string} type @param {any} geometry */
  sketched(type, geometry) {
    this.end();
    this.on.say("");
    const points = geometry.getCoordinates();
    this.on.drawn(type, (type === "LineString" ? points : points[0].slice(0, -1)).map((/** @type {number[]} */ one) => flipped(one)));
  }

  end() {
    this.sketching?.forEach((draw, k) => this.views[k].map.removeInteraction(draw));
    this.sketching = null;
  }
}

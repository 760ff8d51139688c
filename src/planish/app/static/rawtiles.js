/**
 * Pictures as raw 16-bit tiles, coloured here on a 2D canvas: colours, masks and brushes ask the server nothing.
 *
 * @typedef {{id: string, name: string, title: string, layer: string, plane: string, units: string, shape: number[],
 *   pixel_um: number[], origin_um: number[], levels: number, tile: number, scale: number, offset: number,
 *   range: number[]}} Picture
 * @typedef {{picture: Picture, low: number, high: number}} Brush pixels whose value lies from `low` to `high`
 * @typedef {{palette?: string, low?: number, high?: number, valid?: Picture[], onlyValid?: boolean,
 *   brushes?: Brush[]}} Look
 *   `brushes`: pixels that lie in all of them, and in all masks `valid`, are chosen; `onlyValid`: no others are drawn
 */

import { CHOSEN, codesBetween, coloursOfCodes, packed, paletteOf } from "./colour.js";

/** @import {Api} from "./api.js" */

/* global ol */

/** Tiles that are held, 128 KiB each. */
const MOST_TILES = 768;

/** Code of a pixel of a mask that is true; 1 is false. */
const VALID = 2;
const ONLY_VALID = { codes: [VALID, VALID] };

/** Lengths of the page are um; OpenLayers takes this for that of the views, by its code. */
export const PROJECTION = new ol.proj.Projection({ code: "um", units: "m", metersPerUnit: 1e-6, getPointResolution: (r) => r });

/** Raw tiles of a session, each fetched once. */
class RawTiles {
  /**
   * Begin with no tile.
   * @param {Api} api the server
   */
  constructor(api) {
    this.api = api;
    this.held = new Map();
  }

  /**
   * A tile of a picture.
   * @param {{id: string}} picture the picture
   * @param {number} level 0 is full resolution
   * @param {number} row row of tiles
   * @param {number} col column of tiles
   * @returns {Promise<Uint16Array>}
   */
  get({ id }, level, row, col) {
    const path = `tiles/${id}/${level}/${row}/${col}`;
    let tile = this.held.get(path);
    if (tile) this.held.delete(path);
    else {
      tile = this.fetch(path);
      tile.catch(() => this.held.delete(path)); // asked for again the next time
    }
    this.held.set(path, tile);
    if (this.held.size > MOST_TILES) this.held.delete(this.held.keys().next().value ?? "");
    return tile;
  }

  /**
   * Take a tile from the server.
   * @param {string} path below `/api/`
   * @returns {Promise<Uint16Array>}
   */
  async fetch(path) {
    const response = await this.api.fetch(path);
    return new Uint16Array(await response.arrayBuffer());
  }
}

const sessions = new WeakMap();

/**
 * The raw tiles of a session, which all views share.
 * @param {Api} api the server
 * @returns {RawTiles}
 */
function tilesOf(api) {
  const found = sessions.get(api) ?? new RawTiles(api);
  sessions.set(api, found);
  return found;
}

/**
 * Tiles in um: those of a level cover twice the width of those below it.
 * @param {Picture} picture whose tiles they are
 * @returns {any} grid of OpenLayers
 */
function gridOf({ shape: [rows, cols], pixel_um: [dy, dx], origin_um: [x0, y0], levels, tile }) {
  const [left, top] = [x0 - dx / 2, -(y0 - dy / 2)];
  return new ol.tilegrid.TileGrid({
    origin: [left, top],
    extent: [left, top - rows * dy, left + cols * dx, top],
    resolutions: Array.from({ length: levels }, (_, k) => dx * 2 ** (levels - 1 - k)),
    tileSize: [tile, (tile * dy) / dx],
  });
}

/** A picture in colours. */
export class RawTileSource extends ol.source.ImageTile {
  /**
   * Draw a picture tile by tile.
   * @param {Picture} picture the picture
   * @param {Api} api the server
   * @param {Look} [look] how it is drawn
   */
  constructor(picture, api, look = {}) {
    super({
      loader: (z, x, y) => this.draw(picture.levels - 1 - z, y, x),
      tileGrid: gridOf(picture),
      projection: PROJECTION,
      interpolate: false,
      transition: 0,
      wrapX: false,
    });
    this.picture = picture;
    this.tiles = tilesOf(api);
    this.looks = 0;
    this.look(look);
  }

  /**
   * Draw it in another way.
   * @param {Look} look how it is drawn
   */
  look(look) {
    const { palette = paletteOf(this.picture), low = this.picture.range[0], high = this.picture.range[1] } = look;
    this.colours = coloursOfCodes(this.picture, { palette, low, high });
    this.onlyValid = look.onlyValid ?? false;
    this.valid = this.onlyValid || look.brushes?.length ? (look.valid ?? []) : [];
    this.brushes = (look.brushes ?? []).map((brush) => ({
      picture: brush.picture,
      codes: codesBetween(brush.picture, brush.low, brush.high),
    }));
    this.looks += 1;
    this.setKey(`${this.picture.id} ${this.looks}`);
  }

  /**
   * Draw a tile.
   * @param {number} level 0 is full resolution
   * @param {number} row row of tiles
   * @param {number} col column of tiles
   * @returns {Promise<HTMLCanvasElement>}
   */
  async draw(level, row, col) {
    const { colours, brushes, valid, onlyValid } = this;
    const pictures = [this.picture, ...valid, ...brushes.map((brush) => brush.picture)];
    const [codes, ...others] = await Promise.all(pictures.map((one) => this.tiles.get(one, level, row, col)));
    const side = this.picture.tile;
    const canvas = document.createElement("canvas");
    canvas.width = canvas.height = side;
    const context = canvas.getContext("2d");
    const image = context.createImageData(side, side);
    const pixels = new Uint32Array(image.data.buffer);
    for (let i = 0; i < pixels.length; i++) pixels[i] = colours[codes[i]];
    const masks = others.slice(0, valid.length);
    for (const mask of onlyValid ? masks : []) {
      for (let i = 0; i < pixels.length; i++) if (mask[i] !== VALID) pixels[i] = 0;
    }
    if (brushes.length) choose(pixels, [...brushes, ...masks.map(() => ONLY_VALID)], [...others.slice(valid.length), ...masks]);
    context.putImageData(image, 0, 0);
    return canvas;
  }
}

/**
 * Paint the pixels that lie in all brushes.
 * @param {Uint32Array} pixels colours, of which those of the chosen pixels are changed
 * @param {{codes: number[]}[]} brushes first and last code of each
 * @param {Uint16Array[]} values codes of the pixels for each brush
 */
function choose(pixels, brushes, values) {
  const chosen = packed(CHOSEN);
  for (let i = 0; i < pixels.length; i++) {
    if (pixels[i] === 0) continue;
    let inside = true;
    for (let k = 0; inside && k < brushes.length; k++) {
      const [first, last] = brushes[k].codes;
      inside = values[k][i] >= first && values[k][i] <= last;
    }
    if (inside) pixels[i] = chosen;
  }
}

/**
 * A layer that shows a picture; `layer.getSource().look(...)` draws it in another way.
 * @param {Picture} picture the picture
 * @param {Api} api the server
 * @param {Look} [look] how it is drawn
 * @returns {any} layer of OpenLayers
 */
export const rawTileLayer = (picture, api, look = {}) =>
  new ol.layer.Tile({ source: new RawTileSource(picture, api, look) });

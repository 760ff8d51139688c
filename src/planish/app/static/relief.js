/**
 * The sheet in space. While it turns, no more triangles are drawn than the last frame had time for; once it stands
 * still, all that the screen can show, a strip a frame, so that the page never waits for a long one.
 */

import { extentOf, stripOf } from "./sheetmesh.js";

/**
 * @import {Grid} from "./sheetmesh.js"
 * @typedef {{levels: number, step: number, shapeAt: (level: number) => number[],
 *   gridAt: (level: number) => Promise<Grid>}} SheetInSpace
 *   `step`: um between points of level 0; `shapeAt`: rows and columns
 */

const FRAME_MS = 70; // a turning frame is meant to take no longer; 100 is the limit
const STILL_MS = 150; // after the last move
const MOST = 1_000_000; // triangles in full detail
const STRIP = 20_000; // triangles drawn between two looks at the clock
const FIRST = 20_000; // triangles of the first frame, when no time is known yet
const SIZES = 12; // of frames whose times are kept

export class Relief {
  /**
   * Make the scene.
   * @param {HTMLCanvasElement} canvas where it is drawn
   * @param {any} three the module three.js
   * @param {any} Orbit OrbitControls of three.js
   * @param {SheetInSpace} sheet the sheet
   */
  constructor(canvas, three, Orbit, sheet) {
    this.canvas = canvas;
    this.three = three;
    this.sheet = sheet;
    this.renderer = new three.WebGLRenderer({ canvas, antialias: false, alpha: true, preserveDrawingBuffer: true });
    this.renderer.autoClear = false;
    this.renderer.outputColorSpace = three.LinearSRGBColorSpace; // colours as the bar has them, shaded
    this.scene = new three.Scene();
    this.scene.add(new three.HemisphereLight(0xffffff, 0x999999, 2.0));
    const sun = new three.DirectionalLight(0xffffff, 1.1);
    sun.position.set(-0.5, 0.4, 1);
    this.scene.add(sun);
    this.camera = new three.PerspectiveCamera(35, 1, 1, 1e6);
    this.camera.up.set(0, 0, 1);
    this.material = new three.MeshLambertMaterial({ vertexColors: true, side: three.DoubleSide });
    this.controls = new Orbit(this.camera, canvas);
    this.controls.addEventListener("change", () => this.moved());
    this.meshes = new Map(); // level -> {meshes, triangles, step}
    this.times = new Map(); // of frames by their triangles: the slower of the last two, and the last, in ms
    this.last = null;
    this.height = 1;
    this.drawn = { triangles: 0, milliseconds: 0, full: false };
    this.still = 0;
  }

  /**
   * Show the sheet from above, as it lies, tilted a little.
   * @returns {Promise<void>}
   */
  async start() {
    const coarse = this.sheet.levels - 1;
    const made = await this.level(coarse);
    const { centre, size } = made;
    this.size = size;
    this.controls.target.set(...centre);
    this.camera.position.set(centre[0], centre[1] - 1.2 * size, centre[2] + 1.5 * size);
    this.camera.near = size / 1000;
    this.camera.far = 20 * size;
    this.resize();
  }

  /** Fit the picture to the canvas. */
  resize() {
    const { clientWidth, clientHeight } = this.canvas;
    this.renderer.setSize(clientWidth, clientHeight, false);
    this.camera.aspect = clientWidth / Math.max(1, clientHeight);
    this.camera.updateProjectionMatrix();
    this.controls.update();
    this.moved();
  }

  /**
   * Show heights larger than they are.
   * @param {number} factor 1 is true to scale
   */
  exaggerate(factor) {
    this.height = factor;
    for (const { meshes } of this.meshes.values()) for (const mesh of meshes) mesh.scale.z = factor;
    this.moved();
  }

  /** Other colours: all levels are made again when they are needed. */
  recolour() {
    for (const { meshes } of this.meshes.values()) {
      for (const mesh of meshes) { this.scene.remove(mesh); mesh.geometry.dispose(); }
    }
    this.meshes.clear();
    this.level(this.sheet.levels - 1).then(() => this.moved());
  }

  /**
   * Turn the view.
   * @param {number} right in radians
   * @param {number} up in radians
   */
  turn(right, up) {
    const { Spherical, Vector3 } = this.three;
    const from = new Vector3().subVectors(this.camera.position, this.controls.target);
    const at = new Spherical().setFromCartesianCoords(from.x, from.z, -from.y); // three.js measures from y, here z is up
    at.theta += right;
    at.phi = Math.min(Math.PI - 0.01, Math.max(0.01, at.phi - up));
    const to = new Vector3().setFromSpherical(at);
    this.camera.position.set(to.x, -to.z, to.y).add(this.controls.target);
    this.controls.update();
    this.moved();
  }

  /**
   * Change the distance to the sheet.
   * @param {number} factor below 1 comes closer
   */
  zoom(factor) {
    const { target } = this.controls;
    this.camera.position.sub(target).multiplyScalar(factor).add(target);
    this.controls.update();
    this.moved();
  }

  /** Draw at once what a frame has time for, and all of it once nothing moves. */
  moved() {
    this.version = (this.version ?? 0) + 1;
    clearTimeout(this.still);
    this.still = setTimeout(() => this.full(this.version), STILL_MS);
    if (!this.waiting) {
      this.waiting = true;
      requestAnimationFrame(() => { this.waiting = false; this.quick(); });
    }
  }

  /** Draw the finest level that is here and that a frame has time for. */
  quick() {
    const allowed = this.allowed();
    const there = [...this.meshes.entries()].filter(([, made]) => made);
    if (!there.length) return;
    there.sort((a, b) => b[1].triangles - a[1].triangles);
    const fits = there.find(([, made]) => made.triangles <= allowed);
    const [, made] = fits ?? there[there.length - 1];
    this.renderer.clear();
    // Where even the coarsest level is too much, only so many of its strips as there is time for.
    let left = fits ? Infinity : Math.max(1, Math.floor(allowed / STRIP));
    this.draw(made.meshes.filter(() => left-- > 0));
    this.drawn.full = false;
    this.canvas.dataset.detail = "turning";
  }

  /**
   * How many triangles the next frame has time for: by a line through the times of all sizes of frame that were drawn,
   * which holds what a frame takes in any case; where one size is known, in proportion to it.
   * @returns {number}
   */
  allowed() {
    if (!this.last) return FIRST;
    const known = [...this.times].map(([size, [lasted]]) => [size, lasted]);
    const n = known.length;
    const [x, y] = [0, 1].map((k) => known.reduce((sum, one) => sum + one[k], 0) / n);
    const [xx, xy] = [0, 1].map((k) => known.reduce((sum, one) => sum + (one[0] - x) * (one[k] - [x, y][k]), 0));
    const each = n > 1 ? Math.max(xy / xx, 0) : y / x;
    const fits = each > 0 ? x + (FRAME_MS - y) / each : MOST;
    const { triangles, milliseconds } = this.last;
    // No more than some four times the last frame, and less than it where that one was too long.
    const near = milliseconds > FRAME_MS ? (0.8 * triangles * FRAME_MS) / milliseconds : Math.max(FIRST, 4.5 * triangles);
    return Math.min(MOST, fits, near);
  }

  /**
   * Draw some meshes, and keep how long it took.
   * @param {any[]} meshes of three.js
   */
  draw(meshes) {
    const begin = performance.now();
    for (const made of this.meshes.values()) for (const mesh of made.meshes) mesh.visible = false;
    let triangles = 0;
    for (const mesh of meshes) { mesh.visible = true; triangles += mesh.userData.triangles; }
    this.renderer.render(this.scene, this.camera);
    const gl = this.renderer.getContext();
    gl.readPixels(0, 0, 1, 1, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4)); // waits until it is drawn
    const milliseconds = performance.now() - begin;
    this.last = { triangles, milliseconds };
    // Of each size the slower of its last two: one quick frame does not say that the next will be quick.
    const [, before] = this.times.get(triangles) ?? [0, 0];
    this.times.delete(triangles);
    this.times.set(triangles, [Math.max(milliseconds, before), milliseconds]);
    if (this.times.size > SIZES) this.times.delete(this.times.keys().next().value);
    this.drawn = { triangles, milliseconds, full: this.drawn.full };
    Object.assign(this.canvas.dataset, { triangles, milliseconds: milliseconds.toFixed(1) });
  }

  /**
   * All that the screen can show, strip by strip; a move ends it.
   * @param {number} version move that it belongs to
   * @returns {Promise<void>}
   */
  async full(version) {
    const made = await this.level(this.finest());
    if (version !== this.version) return;
    const strips = [...made.meshes];
    let total = 0;
    this.renderer.clear();
    const next = () => {
      if (version !== this.version) return;
      const some = strips.splice(0, Math.max(1, Math.floor(this.allowed() / STRIP)));
      this.draw(some);
      total += some.reduce((sum, mesh) => sum + mesh.userData.triangles, 0);
      if (strips.length) return void requestAnimationFrame(next);
      this.drawn = { ...this.drawn, triangles: total, full: true };
      Object.assign(this.canvas.dataset, { detail: "full", triangles: total });
      this.prepare(version);
    };
    requestAnimationFrame(next);
  }

  /**
   * Make the levels between, which a turning sheet is drawn from, while nothing moves.
   * @param {number} version move that it belongs to
   * @returns {Promise<void>}
   */
  async prepare(version) {
    for (let level = this.sheet.levels - 1; level > this.finest() && version === this.version; level--) {
      await this.level(level);
      await new Promise((done) => setTimeout(done, 20));
    }
  }

  /**
   * The level of which no triangle is smaller than a pixel of the screen, and that has no more than MOST of them.
   * @returns {number}
   */
  finest() {
    const away = this.camera.position.distanceTo(this.controls.target);
    const umPerPixel = (2 * away * Math.tan((this.camera.fov * Math.PI) / 360)) / Math.max(1, this.canvas.clientHeight);
    for (let level = 0; level < this.sheet.levels - 1; level++) {
      const { triangles, step } = this.sizeAt(level);
      if (triangles <= MOST && step >= umPerPixel) return level;
    }
    return this.sheet.levels - 1;
  }

  /**
   * The meshes of a level, made when they are first needed.
   * @param {number} level 0 is full resolution
   * @returns {Promise<any>}
   */
  async level(level) {
    if (!this.meshes.has(level)) {
      const grid = await this.sheet.gridAt(level);
      this.meshes.set(level, this.made(grid));
    }
    return this.meshes.get(level);
  }

  /**
   * How many triangles a level has at most, and how far its points lie apart in um.
   * @param {number} level 0 is full resolution
   * @returns {{triangles: number, step: number}}
   */
  sizeAt(level) {
    const [rows, cols] = this.sheet.shapeAt(level);
    return { triangles: 2 * (rows - 1) * (cols - 1), step: this.sheet.step * 2 ** level };
  }

  /**
   * Make the meshes of a grid, a strip each.
   * @param {Grid} grid points of a level
   * @returns {{meshes: any[], triangles: number, centre: number[], size: number}}
   */
  made(grid) {
    const meshes = [];
    const across = Math.max(1, Math.floor(STRIP / (2 * (grid.cols - 1))));
    let triangles = 0;
    for (let top = 0; top < grid.rows - 1; top += across) {
      const geometry = stripOf(this.three, grid, top, Math.min(grid.rows - 1, top + across));
      if (!geometry) continue;
      const mesh = new this.three.Mesh(geometry, this.material);
      mesh.userData.triangles = geometry.index.count / 3;
      mesh.scale.z = this.height;
      mesh.visible = false;
      triangles += mesh.userData.triangles;
      meshes.push(mesh);
      this.scene.add(mesh);
    }
    return { meshes, triangles, ...extentOf(grid) };
  }
}

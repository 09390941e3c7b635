// The scene on a canvas: tissues that deform around the needle until they are breached (the paper's Fig. 3).
//
// This file knows the state and the geometry; tissue.js, needle.js and marks.js draw.

import { RULER_PX, drawForce, drawInvitation, drawLabels, drawRipples, drawRuler, drawWanted } from "./marks.js";
import { drawNeedle } from "./needle.js";
import { Spring, stations, surfaceAt } from "./surface.js";
import { drawTissueOverNeedle, drawTissues, makeFills } from "./tissue.js";
import { CONTACT } from "./wire.js";

const HEADROOM_M = 0.014; // shown above the highest position of the needle
const FLOOR_M = 0.018; // shown below the last surface, at least
const NEEDLE_RADIUS_M = 0.00065;
const LEAST_NEEDLE_PX = 3.2;
const NEEDLE_RESERVE_M = 0.016; // length of the needle that stays outside when it is all the way in
const SHADES = 5;
const PLAIN_SHADE = 3;
const LARGEST_RATIO = 2.5; // finer pixels cost time and are not seen

const still = matchMedia("(prefers-reduced-motion: reduce)");

export class SceneView {
  /**
   * @param {HTMLCanvasElement} canvas
   * @param {object} options `onBreach(index)` is called for each surface that is pierced
   */
  constructor(canvas, { onBreach = () => {} } = {}) {
    this._canvas = canvas;
    this._context = canvas.getContext("2d", { alpha: false });
    this._onBreach = onBreach;
    this._springs = [];
    this._ripples = [];
    this._frame = null;
    this.tissues = [];
    this.rangeM = [0, 0.085];
    this.tipM = 0;
    this.isPlain = false; // whether all tissues look the same, so that their looks say nothing of how they feel
    new ResizeObserver(() => this._resize()).observe(canvas);
    addEventListener("themechange", () => this._resize());
    this._resize();
  }

  setScene({ tissues, range_m: rangeM }) {
    this.tissues = tissues;
    this.rangeM = rangeM;
    this._springs = tissues.map(() => new Spring());
    this._ripples = [];
    this._frame = null;
    this._resize();
  }

  setFrame(frame) {
    this.tipM = frame.tipM;
    const before = this._frame;
    this._frame = frame.surfacesM.length === this.tissues.length ? frame : null;
    if (!this._frame || !before) return;
    frame.contacts.forEach((contact, index) => {
      if (contact !== CONTACT.PENETRATED || before.contacts[index] === CONTACT.PENETRATED) return;
      const nowMs = performance.now();
      const depthM = before.surfacesM[index] - frame.surfacesM[index];
      if (!still.matches) this._springs[index].release(Math.max(0, depthM), nowMs);
      this._ripples.push({ index, startMs: nowMs });
      this._onBreach(index);
    });
  }

  metresPerPixel() {
    return 1 / this._scale;
  }

  /** Turn a motion [right, down, away] of the hand into one along its axis. */
  toAxes([, down]) {
    return [down];
  }

  contact(index) {
    return this._frame?.contacts[index] ?? CONTACT.NONE;
  }

  /** Share of its breach depth by which a tissue is indented; NaN where its strength is not known. */
  strain(index) {
    if (this.contact(index) !== CONTACT.INDENTED) return 0;
    const tissue = this.tissues[index];
    return ((this._frame.surfacesM[index] - tissue.rest_m) * tissue.stiffness_n_per_m) / tissue.breach_force_n;
  }

  /** Number of the colour of a tissue, 1 to 5, from light to deep. */
  shade(index) {
    const count = this.tissues.length;
    if (this.isPlain) return PLAIN_SHADE;
    if (count === 1) return 1;
    if (count <= SHADES) return 1 + Math.round((index * (SHADES - 1)) / (count - 1));
    return SHADES - Math.abs((index % (2 * SHADES - 2)) - SHADES + 1); // there and back again
  }

  /** Pixels from the top for a depth [m]. */
  y(depthM) {
    return (depthM - this._topM) * this._scale;
  }

  /**
   * Draw one frame.
   * @param {number} nowMs
   * @param {object} shown `wantedM`: where the hand wants the tip, or null; `forceN`: force to draw as an arrow, or null;
   *   `invites`: whether to invite a drag
   */
  draw(nowMs, { wantedM = null, forceN = null, invites = false } = {}) {
    if (devicePixelRatio !== this._seenRatio) this._resize(); // moved to another screen, or zoomed
    if (!this._canvas.width || this._isDrawn(nowMs, [wantedM, forceN, invites])) return;
    const context = this._context;
    context.setTransform(this._ratio, 0, 0, this._ratio, 0, 0);
    this.fills ??= makeFills(context, this);
    context.fillStyle = this.fills.sky;
    context.fillRect(0, 0, this.width, this.height);
    const surfaces = this.tissues.map((tissue, index) => this._surface(tissue, index, nowMs));
    const needle = { x: this.middle, y: this.y(this.tipM), radius: this._radiusPx, scale: this._scale };
    const lengthPx = this._needleLengthM * this._scale;
    drawTissues(context, this, surfaces);
    drawNeedle(context, needle, lengthPx);
    drawTissueOverNeedle(context, this, surfaces, needle, lengthPx);
    drawLabels(context, this);
    this._ripples = drawRipples(context, this, this._ripples, nowMs, still.matches);
    if (forceN !== null) drawForce(context, { x: needle.x + needle.radius + 20, y: needle.y }, { x: 0, y: -forceN }, forceN, this);
    if (invites) drawInvitation(context, needle, nowMs, still.matches);
    const [wanted] = wantedM ?? [null];
    if (wanted !== null) drawWanted(context, this, needle, wanted);
    drawRuler(context, this, wanted);
  }

  /** Whether the canvas already shows this. A scene at rest then costs nothing. */
  _isDrawn(nowMs, shown) {
    const moves = this._ripples.length > 0 || (shown.at(-1) && !still.matches);
    const state = moves ? nowMs : [this.tipM, this._frame?.surfacesM, this._frame?.contacts, ...shown].join();
    if (state === this._drawn) return true;
    this._drawn = state;
    return false;
  }

  /** Heights [px] of a surface at each station. */
  _surface({ rest_m: restM }, index, nowMs) {
    const surfaceM = this._frame ? this._frame.surfacesM[index] : restM;
    const displacementM = surfaceM - restM + this._springs[index].at(nowMs);
    // The lip at the hole is there only while the needle is in it.
    const pierced = this.contact(index) === CONTACT.PENETRATED && this.tipM > surfaceM;
    const radiusM = this._radiusPx / this._scale;
    return this._stations.map((x) => this.y(surfaceAt(x, restM, displacementM, pierced, radiusM)));
  }

  _resize() {
    const { clientWidth, clientHeight } = this._canvas;
    this._seenRatio = devicePixelRatio;
    this._ratio = Math.min(devicePixelRatio || 1, LARGEST_RATIO);
    this._canvas.width = Math.round(clientWidth * this._ratio);
    this._canvas.height = Math.round(clientHeight * this._ratio);
    this.width = Math.max(1, clientWidth - RULER_PX); // of the tissues
    this.height = Math.max(1, clientHeight);
    this.middle = this.width / 2;
    const rests = this.tissues.map((tissue) => tissue.rest_m);
    const first = rests.length ? rests[0] : 0;
    const last = rests.length ? rests.at(-1) : 0;
    this._topM = Math.min(this.rangeM[0], first) - HEADROOM_M;
    this._scale = this.height / (Math.max(this.rangeM[1] + 0.002, last + FLOOR_M) - this._topM);
    this._needleLengthM = Math.max(0.03, this.rangeM[1] - first + NEEDLE_RESERVE_M);
    this._radiusPx = Math.max(LEAST_NEEDLE_PX, NEEDLE_RADIUS_M * this._scale);
    this._stations = stations(this.middle / this._scale + 0.001);
    this.stationsPx = this._stations.map((x) => this.middle + x * this._scale);
    this.fills = null;
    this._drawn = null;
  }
}

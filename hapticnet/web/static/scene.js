// The scene on a canvas: tissues that deform around the needle until they are breached (the paper's Fig. 3).

import { CONTACT } from "./wire.js";
import { palette } from "./palette.js";
import { Spring, stations, surfaceAt } from "./surface.js";
import { drawNeedle, needlePath } from "./needle.js";
import { RULER_PX, drawArrow, drawInvitation, drawLabels, drawRipples, drawRuler, drawWanted } from "./marks.js";

const HEADROOM_M = 0.014; // shown above the highest position of the needle
const FLOOR_M = 0.018; // shown below the last surface, at least
const NEEDLE_RADIUS_M = 0.00065;
const LEAST_NEEDLE_PX = 3.2;
const LAMELLAE = 5;
const LAMELLA_DASHES = [[], [7, 5], [1.5, 5], [12, 4, 2, 4], [3, 3]]; // tells layers apart without colour
const SHADES = 5;

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
    this._tissues = [];
    this._rangeM = [0, 0.085];
    this._springs = [];
    this._ripples = [];
    this._frame = null;
    this.tipM = 0;
    new ResizeObserver(() => this._resize()).observe(canvas);
    addEventListener("themechange", () => this._resize());
    this._resize();
  }

  setScene({ tissues, range_m: rangeM }) {
    this._tissues = tissues;
    this._rangeM = rangeM;
    this._springs = tissues.map(() => new Spring());
    this._ripples = [];
    this._frame = null;
    this._resize();
  }

  setFrame(frame) {
    this.tipM = frame.tipM;
    const before = this._frame;
    this._frame = frame.surfacesM.length === this._tissues.length ? frame : null;
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

  /** Share of its breach depth by which each tissue is indented; NaN where its strength is not known. */
  strain(index) {
    const tissue = this._tissues[index];
    if (this._frame?.contacts[index] !== CONTACT.INDENTED) return 0;
    const indentedM = this._frame.surfacesM[index] - tissue.rest_m;
    return (indentedM * tissue.stiffness_n_per_m) / tissue.breach_force_n;
  }

  /**
   * Draw one frame.
   * @param {number} nowMs
   * @param {object} shown `wantedM`: where the hand wants the tip, or null; `forceN`: force to draw as an arrow, or null;
   *   `invites`: whether to invite a drag
   */
  draw(nowMs, { wantedM = null, forceN = null, invites = false } = {}) {
    const context = this._context;
    if (!this._width || this._isDrawn(nowMs, [wantedM, forceN, invites])) return;
    context.setTransform(this._ratio, 0, 0, this._ratio, 0, 0);
    this._drawSky(context);
    const surfaces = this._tissues.map((_, index) => this._surface(index, nowMs));
    context.save();
    context.beginPath();
    context.rect(0, 0, this._tissueWidth, this._height);
    context.clip();
    this._drawTissues(context, surfaces);
    this._drawGlow(context, surfaces);
    const needle = { x: this._middle, y: this.y(this.tipM), radius: this._radiusPx, scale: this._scale };
    const lengthPx = this.y(this._needleLengthM) - this.y(0);
    drawNeedle(context, needle, lengthPx);
    this._drawTissueOverNeedle(context, surfaces, needle, lengthPx);
    drawLabels(context, this, this._tissues);
    this._ripples = drawRipples(context, this, this._ripples, nowMs, still.matches);
    if (forceN !== null) drawArrow(context, needle, forceN);
    if (invites) drawInvitation(context, needle, nowMs, still.matches);
    if (wantedM !== null) drawWanted(context, this, needle, wantedM);
    context.restore();
    drawRuler(context, this, wantedM);
  }

  /** Whether the canvas already shows this. A scene at rest then costs nothing. */
  _isDrawn(nowMs, shown) {
    const moves = this._ripples.length > 0 || (shown.at(-1) && !still.matches);
    const frame = this._frame;
    const state = moves ? nowMs : [this.tipM, frame?.surfacesM, frame?.contacts, ...shown].join();
    if (state === this._drawnState) return true;
    this._drawnState = state;
    return false;
  }

  /** Pixels from the top for a depth [m]. */
  y(depthM) {
    return (depthM - this._topM) * this._scale;
  }

  get middle() {
    return this._middle;
  }

  get width() {
    return this._tissueWidth;
  }

  get height() {
    return this._height;
  }

  get rangeM() {
    return this._rangeM;
  }

  contact(index) {
    return this._frame?.contacts[index] ?? CONTACT.NONE;
  }

  restM(index) {
    return this._tissues[index].rest_m;
  }

  _resize() {
    const { clientWidth, clientHeight } = this._canvas;
    this._ratio = Math.min(devicePixelRatio || 1, 2.5);
    this._canvas.width = Math.round(clientWidth * this._ratio);
    this._canvas.height = Math.round(clientHeight * this._ratio);
    this._width = clientWidth;
    this._height = clientHeight;
    this._tissueWidth = clientWidth - RULER_PX;
    this._middle = this._tissueWidth / 2;
    const rests = this._tissues.map((tissue) => tissue.rest_m);
    const first = rests.length ? Math.min(...rests) : 0;
    const last = rests.length ? Math.max(...rests) : 0;
    this._topM = Math.min(this._rangeM[0], first) - HEADROOM_M;
    const bottomM = Math.max(this._rangeM[1] + 0.002, last + FLOOR_M);
    this._scale = Math.max(1, clientHeight) / (bottomM - this._topM);
    this._needleLengthM = this._rangeM[1] - first + 0.016;
    this._radiusPx = Math.max(LEAST_NEEDLE_PX, NEEDLE_RADIUS_M * this._scale);
    this._stations = stations(this._tissueWidth / 2 / this._scale + 0.001);
    this._fills = null;
    this._drawnState = null;
  }

  /** Heights [px] of a surface at each station. */
  _surface(index, nowMs) {
    const tissue = this._tissues[index];
    const surfaceM = this._frame ? this._frame.surfacesM[index] : tissue.rest_m;
    const displacementM = surfaceM - tissue.rest_m + this._springs[index].at(nowMs);
    // The lip at the hole is there only while the needle is in it.
    const pierced = this.contact(index) === CONTACT.PENETRATED && this.tipM > surfaceM;
    const radiusM = this._radiusPx / this._scale;
    return this._stations.map((x) => this.y(surfaceAt(x, tissue.rest_m, displacementM, pierced, radiusM)));
  }

  /** Number of the colour of a tissue, 1 to 5, from light to deep. */
  shade(index) {
    const count = this._tissues.length;
    if (count === 1) return 1;
    return 1 + (count <= SHADES ? Math.round((index * (SHADES - 1)) / (count - 1)) : index % SHADES);
  }

  _drawSky(context) {
    if (!this._fills) this._makeFills(context);
    context.fillStyle = this._fills.sky;
    context.fillRect(0, 0, this._width, this._height);
  }

  _makeFills(context) {
    const colour = palette();
    const gradient = (fromY, toY, ...stops) => {
      const fill = context.createLinearGradient(0, fromY, 0, toY);
      stops.forEach((stop, index) => fill.addColorStop(index / (stops.length - 1), stop));
      return fill;
    };
    // Lines fade towards the left, where the names are.
    const lines = (name) => {
      const fill = context.createLinearGradient(0, 0, this._tissueWidth, 0);
      const [red, green, blue, alpha] = colour(name).split(" ");
      [[0, 0.15], [0.15, 0.15], [0.45, 1], [1, 0.6]].forEach(([at, share]) =>
        fill.addColorStop(at, `rgb(${red} ${green} ${blue} / ${Number(alpha) * share})`));
      return fill;
    };
    this._fills = {
      lamellae: [lines("lamella"), lines("lamella-deep")],
      sky: gradient(0, this._height, colour("sky-top"), colour("sky-bottom")),
      layers: this._tissues.map((tissue, index) => {
        const next = this._tissues[index + 1]?.rest_m ?? tissue.rest_m + 0.024;
        const shade = this.shade(index);
        return gradient(this.y(tissue.rest_m), this.y(next), colour(`tissue-${shade}`), colour(`tissue-${shade}-deep`));
      }),
    };
  }

  _trace(path, heights, reverse = false) {
    const count = heights.length;
    for (let k = 0; k < count; k += 1) {
      const at = reverse ? count - 1 - k : k;
      path.lineTo(this._middle + this._stations[at] * this._scale, heights[at]);
    }
  }

  _drawTissues(context, surfaces) {
    const colour = palette();
    surfaces.forEach((heights, index) => {
      const body = new Path2D();
      this._trace(body, heights);
      body.lineTo(this._tissueWidth + 2, this._height);
      body.lineTo(-2, this._height);
      context.fillStyle = this._fills.layers[index];
      context.fill(body);
      this._drawLamellae(context, heights, surfaces[index + 1], index);
      const edge = new Path2D();
      this._trace(edge, heights);
      context.lineJoin = "round";
      context.setLineDash([]);
      context.strokeStyle = colour("tissue-shadow");
      context.lineWidth = 7;
      context.save();
      context.translate(0, 4);
      context.stroke(edge);
      context.restore();
      context.strokeStyle = colour("tissue-edge");
      context.lineWidth = 2;
      context.stroke(edge);
    });
  }

  /** Lines inside a layer that follow both its surfaces: they show how the tissue is compressed. */
  _drawLamellae(context, heights, below, index) {
    const floor = this.y(this._tissues[index].rest_m + 0.026);
    context.strokeStyle = this._fills.lamellae[this.shade(index) > 3 ? 1 : 0];
    context.lineWidth = 1.2;
    context.setLineDash(LAMELLA_DASHES[index % LAMELLA_DASHES.length]);
    context.beginPath(); // one stroke for all lines of a layer: half the time
    for (let k = 1; k <= LAMELLAE; k += 1) {
      const share = k / (LAMELLAE + 1);
      for (let at = 0; at < heights.length; at += 1) {
        const y = heights[at] + share * (Math.max(heights[at], below?.[at] ?? floor) - heights[at]);
        const x = this._middle + this._stations[at] * this._scale;
        if (at === 0) context.moveTo(x, y);
        else context.lineTo(x, y);
      }
    }
    context.stroke();
    context.setLineDash([]);
  }

  /** A glow under the tip that grows until the tissue gives way. Only where its strength is known. */
  _drawGlow(context, surfaces) {
    const x = this._middle;
    const y = this.y(this.tipM);
    surfaces.forEach((heights, index) => {
      const strain = this.strain(index);
      if (!(strain > 0.01)) return;
      const reach = (0.006 + 0.009 * Math.min(1, strain)) * this._scale;
      const glow = context.createRadialGradient(x, y, 1, x, y, reach);
      const colour = palette()("glow");
      const strength = Math.min(1, strain) * 0.85;
      glow.addColorStop(0, `rgb(${colour} / ${strength})`);
      glow.addColorStop(0.45, `rgb(${colour} / ${strength * 0.35})`);
      glow.addColorStop(1, `rgb(${colour} / 0)`);
      const body = new Path2D();
      this._trace(body, heights);
      body.lineTo(this._tissueWidth, this._height);
      body.lineTo(0, this._height);
      context.save();
      context.clip(body);
      context.fillStyle = glow;
      context.fillRect(x - reach, y - reach, 2 * reach, 2 * reach);
      context.restore();
    });
  }

  /** Tint the part of the needle that is inside, so that it looks embedded. */
  _drawTissueOverNeedle(context, surfaces, needle, lengthPx) {
    context.save();
    context.clip(needlePath(needle, lengthPx));
    context.globalAlpha = 0.3;
    surfaces.forEach((heights, index) => {
      if (this.contact(index) !== CONTACT.PENETRATED) return;
      const top = heights[Math.floor(heights.length / 2)];
      context.fillStyle = this._fills.layers[index];
      context.fillRect(needle.x - 30, top, 60, this._height);
    });
    context.restore();
    const hole = palette()("hole");
    surfaces.forEach((heights, index) => {
      const top = heights[Math.floor(heights.length / 2)];
      if (this.contact(index) !== CONTACT.PENETRATED || needle.y < top) return;
      context.strokeStyle = hole;
      context.lineWidth = 2;
      context.beginPath();
      context.ellipse(needle.x, top, needle.radius * 1.7, needle.radius * 0.55, 0, 0, Math.PI);
      context.stroke();
    });
  }
}

// Scenes that are no layers of tissue: the shapes that the scene describes, the tool, its path and the force on it.
//
// Drawn from slightly above and without perspective, so that a millimetre is as long everywhere. Coordinates are those of
// the hand; `view` says which of them point up, right and away.

import { drawForce, drawScale } from "./marks.js";
import { palette } from "./palette.js";

const TURN = 0.42; // of the view around the vertical, and down [rad]
const TILT = 0.48;
const DEFAULT_VIEW = { up: [-1, 0, 0], right: [0, 1, 0], away: [0, 0, 1] };
const LEAST_RADIUS_M = 0.03; // shown around the middle
const MOST_RADIUS_M = 0.3; // of one shape that counts for what is shown: a floor may be as large as it likes
const MARGIN_PX = 30;
const VEIL = 0.72; // of a plane, over what lies inside it
const PATH_POINTS = 150;
const TOOL_PX = 5;
const STEM_PX = 46;
const SHADES = 5;
const LIGHT = unit([-0.45, 0.8, -0.4]); // from: right, up, away

const dot = (a, b) => a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
const along = (a, s, b) => [a[0] + s * b[0], a[1] + s * b[1], a[2] + s * b[2]];
const cross = (a, b) => [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]];

function unit(a) {
  const length = Math.hypot(...a) || 1;
  return a.map((each) => each / length);
}

const full = (vector) => [0, 1, 2].map((axis) => vector?.[axis] ?? 0);

export class SpaceView {
  constructor(canvas) {
    this._canvas = canvas;
    this._context = canvas.getContext("2d", { alpha: false });
    this.tip = [0, 0, 0];
    this.clear();
    const again = () => (this._drawn = null);
    new ResizeObserver(again).observe(canvas);
    addEventListener("themechange", again);
  }

  clear() {
    this.shapes = [];
    this._axes = 1;
    this._path = [];
    this._drawn = null;
    this._version = 0;
    this._look(DEFAULT_VIEW);
  }

  setScene({ axes = 1, range_m: [low, high] }) {
    this._axes = axes;
    this._path = [];
    this._seen = { low: [low, 0, 0], high: [Math.min(high, low + 0.06), 0, 0] };
    this._look(this._view);
    this._drawn = null;
  }

  setShapes({ count, changed }) {
    this.shapes.length = Math.min(this.shapes.length, count);
    for (const [place, [kind, at, size, first, second]] of Object.entries(changed)) {
      const axes = [full(first), full(second)];
      this.shapes[place] = { kind, at: full(at), size: full(size), axes: [...axes, cross(...axes)] };
    }
    const view = this.shapes.find((each) => each?.kind === "view");
    this._look(view ? { up: view.axes[0], right: view.axes[1], away: view.size } : DEFAULT_VIEW);
    this._version += 1;
  }

  setFrame({ tipM, furtherM }) {
    this.tip = [tipM, ...furtherM, 0, 0].slice(0, 3);
    const last = this._path.at(-1);
    if (last && Math.hypot(...along(last, -1, this.tip)) < 1e-5) return;
    this._path.push(this.tip);
    if (this._path.length > PATH_POINTS) this._path.shift();
  }

  metresPerPixel() {
    return 1 / this._scale;
  }

  /** What is seen, in words: "a plane and 2 spheres"; empty if the scene describes nothing. */
  words() {
    const counts = new Map();
    for (const each of this.shapes) if (each && each.kind !== "view") counts.set(each.kind, (counts.get(each.kind) ?? 0) + 1);
    const parts = [...counts].map(([kind, n]) => (n === 1 ? `a ${kind}` : `${n} ${kind}${kind === "box" ? "es" : "s"}`));
    return parts.length > 1 ? `${parts.slice(0, -1).join(", ")} and ${parts.at(-1)}` : parts.join("");
  }

  /** Turn a motion [right, down, away] of the hand into one along its axes. */
  toAxes(motion) {
    return Array.from({ length: this._axes }, (_, axis) => motion.reduce((sum, each, way) => sum + each * this._controls[axis][way], 0));
  }

  /** Each axis of the hand is moved along the direction of the picture that it points along most. */
  _look(view) {
    this._view = view;
    const ways = [view.right, view.up.map((each) => -each), view.away];
    const free = new Set([0, 1, 2]);
    this._controls = Array.from({ length: this._axes }, (_, axis) => {
      const best = [...free].reduce((a, b) => (Math.abs(ways[b][axis]) > Math.abs(ways[a][axis]) + 1e-6 ? b : a));
      free.delete(best);
      const weights = [0, 0, 0];
      weights[best] = Math.sign(ways[best][axis]) || 1;
      if (this._axes === 1 && best !== 1) weights[1] = 1; // a drag down and ↓ always move the first axis
      return weights;
    });
    const [c, s] = [Math.cos(TURN), Math.sin(TURN)];
    const level = along([0, 0, 0], c, view.right).map((each, k) => each + s * view.away[k]);
    const back = along([0, 0, 0], -s, view.right).map((each, k) => each + c * view.away[k]);
    this._across = level;
    this._upward = along(view.up.map((each) => Math.cos(TILT) * each), Math.sin(TILT), back);
    this._depth = along(back.map((each) => Math.cos(TILT) * each), -Math.sin(TILT), view.up);
  }

  /** Pixels of a point. */
  at(point) {
    const from = along(point, -1, this._middle);
    return { x: this._width / 2 + this._scale * dot(from, this._across), y: this._height / 2 - this._scale * dot(from, this._upward) };
  }

  draw(nowMs, { wantedM = null, forceN = null, invites = false } = {}) {
    const canvas = this._canvas;
    const state = [this.tip, this._version, wantedM, forceN, invites, canvas.width, canvas.height].join();
    if (!canvas.width || state === this._drawn) return;
    this._drawn = state;
    this._width = canvas.clientWidth;
    this._height = canvas.clientHeight;
    this._fit();
    const context = this._context;
    const colour = palette();
    const ratio = canvas.width / this._width;
    context.setTransform(ratio, 0, 0, ratio, 0, 0);
    const sky = context.createLinearGradient(0, 0, 0, this._height);
    sky.addColorStop(0, colour("sky-top"));
    sky.addColorStop(1, colour("sky-bottom"));
    context.fillStyle = sky;
    context.fillRect(0, 0, this._width, this._height);
    context.lineJoin = context.lineCap = "round";
    const planes = this.shapes.filter((each) => each?.kind === "plane");
    const solids = this.shapes.filter((each) => each && each.kind !== "view" && each.kind !== "plane");
    const isInside = ({ at }) => planes.some((plane) => dot(along(at, -1, plane.at), plane.axes[0]) > 0);
    const draw = (items) => this._backToFront(items).forEach((each) => this._drawSolid(each, this.shapes.indexOf(each)));
    draw(solids.filter(isInside));
    planes.forEach((each) => this._drawPlane(each));
    draw([...solids.filter((each) => !isInside(each)), { kind: "tool", at: this.tip, size: [1e-4, 0, 0], axes: [] }]);
    this._drawPath();
    const tip = this.at(this.tip);
    context.strokeStyle = colour("ink");
    context.lineWidth = 1.2;
    circle(context, tip, TOOL_PX);
    context.stroke(); // the tool is seen through what hides it
    if (wantedM) this._drawWanted(tip, this.at(full(wantedM)));
    if (forceN) this._drawForceOn(tip, forceN);
    drawScale(context, this._scale);
    context.lineCap = "butt";
  }

  /** Show all that is near, and where the tool was. */
  _fit() {
    const seen = this._seen;
    const take = (point, by = 0) => point.forEach((each, axis) => {
      seen.low[axis] = Math.min(seen.low[axis], each - by);
      seen.high[axis] = Math.max(seen.high[axis], each + by);
    });
    for (const each of this.shapes) {
      if (!each || each.kind === "view") continue;
      const reach = each.kind === "plane" ? 0 : Math.min(MOST_RADIUS_M, Math.max(...each.size) + (each.kind === "capsule" ? each.size[0] : 0));
      take(each.at, reach);
    }
    take(this.tip, 0.005);
    this._middle = seen.low.map((each, axis) => (each + seen.high[axis]) / 2);
    const half = seen.high.map((each, axis) => Math.max(LEAST_RADIUS_M / 2, (each - seen.low[axis]) / 2));
    this._radius = Math.hypot(...half);
    const reach = (way) => way.reduce((sum, each, axis) => sum + Math.abs(each) * half[axis], 0);
    this._scale = Math.min((this._width / 2 - MARGIN_PX) / reach(this._across), Math.max(this._height / 4, this._height / 2 - 2 * MARGIN_PX) / reach(this._upward));
  }

  _shade(number) {
    return palette()(`tissue-${1 + (number % SHADES)}`);
  }

  /** What the light leaves of a colour on a face. */
  _fillFace(fill, normal, colour) {
    const { up, right, away } = this._view;
    const light = dot([dot(normal, right), dot(normal, up), dot(normal, away)], LIGHT);
    const context = this._context;
    context.fillStyle = colour;
    context.fill(fill);
    context.fillStyle = light > 0 ? `rgb(255 255 255 / ${0.3 * light})` : `rgb(20 5 15 / ${0.12 - 0.3 * light})`;
    context.fill(fill);
    context.strokeStyle = palette()("tissue-edge");
    context.lineWidth = 1;
    context.stroke(fill);
  }

  /** A part of a plane, with lines on it. */
  _drawPlane(shape) {
    const [inward] = shape.axes;
    const centre = along(this._middle, dot(along(shape.at, -1, this._middle), inward), inward);
    const helper = Math.abs(dot(inward, this._view.right)) < 0.8 ? this._view.right : this._view.away;
    const first = unit(along(helper, -dot(helper, inward), inward));
    const second = cross(inward, first);
    const half = this._radius * 1.1;
    const corner = (a, b) => along(along(centre, a * half, first), b * half, second);
    const context = this._context;
    context.globalAlpha = VEIL;
    this._fillFace(this._polygon([corner(-1, -1), corner(1, -1), corner(1, 1), corner(-1, 1)]), inward.map((each) => -each), this._shade(this.shapes.indexOf(shape)));
    context.globalAlpha = 1;
    context.strokeStyle = `rgb(${palette()("lamella")})`;
    for (let k = -5; k <= 5; k += 1) {
      context.stroke(this._polygon([corner(k / 5, -1), corner(k / 5, 1)]));
      context.stroke(this._polygon([corner(-1, k / 5), corner(1, k / 5)]));
    }
  }

  _polygon(points) {
    const path = new Path2D();
    for (const { x, y } of points.map((each) => this.at(each))) path.lineTo(x, y);
    path.closePath();
    return path;
  }

  _drawSolid(shape, number) {
    const context = this._context;
    if (shape.kind === "tool") return this._drawTool();
    const colour = this._shade(number);
    if (shape.kind === "box") {
      for (const { normal, corners } of visibleFaces(shape, this._depth)) this._fillFace(this._polygon(corners), normal, colour);
      return undefined;
    }
    const reach = shape.kind === "capsule" ? shape.size[1] : 0;
    const [from, to] = [-reach, reach].map((by) => this.at(along(shape.at, by, shape.axes[0])));
    const radius = Math.max(1, shape.size[0] * this._scale);
    const line = (width, style, shift) => {
      context.strokeStyle = style;
      context.lineWidth = width;
      context.beginPath();
      context.moveTo(from.x - shift, from.y - shift);
      context.lineTo(to.x - shift + 0.01, to.y - shift);
      context.stroke();
    };
    line(2 * radius + 2, palette()("tissue-edge"), 0);
    line(2 * radius, colour, 0);
    line(2 * radius, "rgb(20 5 15 / 14%)", 0);
    for (const [share, light] of [[1.5, 0.1], [1.0, 0.14], [0.5, 0.18]]) line(share * radius, `rgb(255 255 255 / ${light})`, (1 - share / 2) * 0.5 * radius);
    return undefined;
  }

  _drawTool() {
    const context = this._context;
    const { x, y } = this.at(this.tip);
    const colour = palette();
    const stem = context.createLinearGradient(0, y - STEM_PX, 0, y);
    stem.addColorStop(0, colour("hub"));
    stem.addColorStop(1, colour("steel-dark"));
    context.strokeStyle = stem;
    context.lineWidth = 3.5;
    context.beginPath();
    context.moveTo(x, y);
    context.lineTo(x, y - STEM_PX);
    context.stroke();
    context.fillStyle = colour("steel-light");
    circle(context, { x, y }, TOOL_PX);
    context.fill();
  }

  _drawPath() {
    const context = this._context;
    context.strokeStyle = palette()("hand");
    context.lineWidth = 2;
    const points = this._path.map((each) => this.at(each));
    for (let k = 1; k < points.length; k += 1) {
      context.globalAlpha = (0.6 * k) / points.length;
      context.beginPath();
      context.moveTo(points[k - 1].x, points[k - 1].y);
      context.lineTo(points[k].x, points[k].y);
      context.stroke();
    }
    context.globalAlpha = 1;
  }

  _drawWanted(tip, wanted) {
    const context = this._context;
    context.strokeStyle = palette()("hand");
    context.lineWidth = 1.5;
    context.setLineDash([2, 4]);
    context.beginPath();
    context.moveTo(tip.x, tip.y);
    context.lineTo(wanted.x, wanted.y);
    context.stroke();
    context.setLineDash([]);
    circle(context, wanted, TOOL_PX + 4);
    context.stroke();
  }

  /** A force is positive where it pushes against its axis. */
  _drawForceOn(tip, forceN) {
    const push = full(forceN).map((each) => -each);
    drawForce(this._context, tip, { x: dot(push, this._across), y: -dot(push, this._upward) }, Math.hypot(...push), { width: this._width, height: this._height });
  }

  /** The solids in an order in which each covers those behind it. */
  _backToFront(solids) {
    const far = solids.map((each) => ({ each, depth: dot(each.at, this._depth), faces: each.kind === "box" ? visibleFaces(each, this._depth) : [] }));
    far.sort((a, b) => b.depth - a.depth);
    const ordered = [];
    const begun = new Set();
    const put = (item) => {
      if (begun.has(item)) return;
      begun.add(item);
      for (const other of far) if (!begun.has(other) && covers(item, other)) put(other);
      ordered.push(item.each);
    };
    far.forEach(put);
    return ordered;
  }
}

/** Whether one solid is surely in front of another: on the outer side of a face of it that is seen. */
function covers(front, back) {
  return back.faces.some(({ normal, corners }) => {
    const outside = dot(along(front.each.at, -1, corners[0]), normal);
    return outside >= 0.7 * extent(front.each, normal) - 1e-4;
  });
}

function extent({ kind, size, axes }, normal) {
  if (kind === "box") return axes.reduce((sum, axis, k) => sum + size[k] * Math.abs(dot(axis, normal)), 0);
  return size[0] + (kind === "capsule" ? size[1] * Math.abs(dot(axes[0], normal)) : 0);
}

/** The faces of a box that look against the direction of view: outward normal and corners. */
function visibleFaces({ at, size, axes }, depth) {
  return [0, 1, 2].map((k) => {
    const sign = dot(axes[k], depth) < 0 ? 1 : -1;
    const centre = along(at, sign * size[k], axes[k]);
    const [a, b] = [(k + 1) % 3, (k + 2) % 3];
    const corner = (s, t) => along(along(centre, s * size[a], axes[a]), t * size[b], axes[b]);
    return { normal: axes[k].map((each) => sign * each), corners: [corner(-1, -1), corner(1, -1), corner(1, 1), corner(-1, 1)] };
  });
}

function circle(context, { x, y }, radius) {
  context.beginPath();
  context.arc(x, y, radius, 0, 2 * Math.PI);
}

// The plot of forces over the last seconds: uPlot, with a mark for each packet that arrived.
//
// It can be paused, and dragging across it pauses it and enlarges that part.

import { palette } from "./palette.js";

/* global uPlot */

export const LINES = ["true", "held", "sensed", "band"];

const STEPS_N = [1, 2, 3, 4, 6, 8, 10, 15, 20, 30, 50, 100, 200, 500, 1000];
const SHRINK_AFTER_MS = 3000;
const MARK_PX = 9;
const DASH_PX = 6;
const DASH_SHARE = 0.6;
const FONT = "12px Inter, system-ui, sans-serif";
const SERIES = { held: [3], true: [4], sensed: [5], band: [1, 2] };

export class ForcePlot {
  /**
   * @param {HTMLElement} box
   * @param {number} seconds length of the time axis
   * @param {function} onPause called with true or false
   */
  constructor(box, seconds, onPause) {
    this._box = box;
    this._seconds = seconds;
    this._onPause = onPause;
    this._frozen = null;
    this._zoom = null;
    this._edge = 0;
    this._top = 2;
    this._bottom = 0;
    this._fitMs = 0;
    this._packets = new Float32Array(0);
    this._plot = new uPlot(this._options(), [[], [], [], [], [], []], box);
    new ResizeObserver(() => this._plot.setSize(this._size())).observe(box);
  }

  get isPaused() {
    return this._frozen !== null;
  }

  setPaused(paused) {
    if (paused === this.isPaused) return;
    // Views of the history change with the next message; a frozen plot needs its own copy.
    this._frozen = paused ? this._plot.data.map((column) => column.slice()) : null;
    if (paused) this._packets = this._packets.slice();
    this._zoom = null;
    this._onPause(paused);
    this._draw(this._frozen ?? this._plot.data);
    this._plot.redraw(false, true); // the label of the right edge changes although the axis does not
  }

  show(line, visible) {
    for (const series of SERIES[line]) this._plot.setSeries(series, { show: visible });
  }

  /** Draw what is known up to `edgeS` of the server's time. `columns`: low, high, held, true, sensed. */
  update(edgeS, time, columns, packets, nowMs) {
    if (this.isPaused) return;
    this._edge = edgeS;
    this._packets = packets;
    this._fit(columns, nowMs);
    this._draw([time, ...columns]);
  }

  /** Index of the sample under the mouse, or null. */
  get hovered() {
    const { left } = this._plot.cursor;
    return left >= 0 ? this._plot.posToIdx(left) : null;
  }

  value(series, index) {
    return this._plot.data[SERIES[series].at(-1)][index];
  }

  /** Limits of the threshold at a sample, or null without one. */
  band(index) {
    const [, low, high] = this._plot.data;
    return index === null ? null : { low: low[index], high: high[index] };
  }

  _draw(data) {
    const [min, max] = this._zoom ?? [this._edge - this._seconds, this._edge];
    this._plot.batch(() => {
      this._plot.setData(data, false);
      this._plot.setScale("x", { min, max });
      this._plot.setScale("y", { min: this._bottom, max: this._top });
    });
  }

  /** Grow the axis at once, shrink it after a while, in few steps: an axis that moves cannot be read. */
  _fit(columns, nowMs) {
    let highest = 0.4;
    let lowest = 0;
    for (const column of columns.slice(2)) {
      for (let row = 0; row < column.length; row += 2) {
        if (column[row] > highest) highest = column[row];
        else if (column[row] < lowest) lowest = column[row];
      }
    }
    const step = (force) => STEPS_N.find((each) => each >= force * 1.06) ?? force * 1.2;
    const top = step(highest);
    const bottom = lowest < -0.15 ? -step(-lowest) : -top * 0.035;
    const shrinks = top < this._top || bottom > this._bottom;
    if (!shrinks) this._fitMs = nowMs;
    if (top >= this._top && bottom <= this._bottom) [this._top, this._bottom] = [top, bottom];
    else if (nowMs - this._fitMs > SHRINK_AFTER_MS) [this._top, this._bottom, this._fitMs] = [top, bottom, nowMs];
    else [this._top, this._bottom] = [Math.max(top, this._top), Math.min(bottom, this._bottom)];
  }

  _size() {
    return { width: Math.max(100, this._box.clientWidth), height: Math.max(80, this._box.clientHeight) };
  }

  _options() {
    const from = (name) => () => palette()(name);
    const line = (name, width, paths) => ({ stroke: from(name), width, paths, points: { show: false } });
    const axis = { stroke: from("muted"), font: FONT, ticks: { show: false }, grid: { stroke: from("grid"), width: 1 } };
    return {
      ...this._size(),
      padding: [10, 28, 0, 0], // on the right, room for half of the word "paused"
      legend: { show: false },
      cursor: { y: false, points: { show: false }, drag: { x: true, y: false, setScale: false } },
      scales: { x: { time: false, auto: false }, y: { auto: false } },
      axes: [
        { ...axis, size: 30, splits: (_, __, min, max) => this._splits(min, max), values: (_, all) => all.map((t) => this._ago(t)) },
        { ...axis, size: 46, splits: (_, __, min, max) => forces(min, max), values: (_, all) => all.map((n) => `${minus(n)} N`) },
      ],
      series: [{}, line(null, 0), line(null, 0), line("held", 3), line("true", 1.25), line("sensed", 1.75, dashed)],
      bands: [{ series: [2, 1], fill: from("band") }],
      hooks: {
        draw: [(plot) => this._drawMarks(plot)],
        setSelect: [(plot) => this._enlarge(plot)],
        ready: [(plot) => plot.over.addEventListener("dblclick", () => this._resetZoom())],
      },
    };
  }

  _enlarge(plot) {
    const { left, width } = plot.select;
    if (width < 6) return;
    const zoom = [plot.posToVal(left, "x"), plot.posToVal(left + width, "x")];
    plot.setSelect({ left: 0, top: 0, width: 0, height: 0 }, false);
    this.setPaused(true);
    this._zoom = zoom;
    this._draw(this._frozen);
  }

  _resetZoom() {
    this._zoom = null;
    if (this.isPaused) this._draw(this._frozen);
  }

  _drawMarks(plot) {
    const { ctx, bbox } = plot;
    const ratio = bbox.width / plot.over.clientWidth;
    const times = plot.data[0];
    ctx.save();
    ctx.beginPath();
    ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
    ctx.clip();
    ctx.fillStyle = palette()("held");
    let last = -1;
    for (let row = 0; row < this._packets.length; row += 1) {
      if (!(this._packets[row] > 0)) continue;
      const x = Math.round(plot.valToPos(times[row], "x", true));
      if (x === last) continue;
      last = x;
      ctx.fillRect(x, bbox.top + bbox.height - MARK_PX * ratio, Math.max(1, ratio), MARK_PX * ratio);
    }
    ctx.restore();
  }

  // Ticks stand still relative to the right edge, which is the present.
  _splits(min, max) {
    const step = niceStep((max - min) / 5);
    const splits = [];
    for (let ago = Math.ceil((this._edge - max) / step - 1e-6); this._edge - ago * step >= min - 1e-6; ago += 1) {
      splits.unshift(this._edge - ago * step);
    }
    return splits;
  }

  _ago(time) {
    const ago = this._edge - time;
    if (ago < 5e-4) return this.isPaused ? "paused" : "now";
    return `−${Number(ago.toFixed(3))} s`;
  }
}

/**
 * Path of a dashed line for noisy values, for uPlot. A dash pattern follows the length of a path, so noise would use it
 * up; here the line is cut at equal times. In each column of pixels it goes from the smallest value to the largest.
 */
function dashed(plot, series, from, to) {
  const [times, values] = [plot.data[0], plot.data[series]];
  const { min, max } = plot.scales.x;
  const { left, width } = plot.bbox;
  const period = (DASH_PX * width) / plot.over.clientWidth;
  const scale = width / (max - min);
  const phase = Math.floor(min * scale); // so that dashes move with the line
  const stroke = new Path2D();
  let [column, low, high, isOn] = [NaN, Infinity, -Infinity, false];
  const finish = () => {
    const draws = low <= high && ((column + phase) % period) / period < DASH_SHARE;
    if (draws) {
      const y = plot.valToPos(low, "y", true);
      if (isOn) stroke.lineTo(left + column, y);
      else stroke.moveTo(left + column, y);
      stroke.lineTo(left + column, plot.valToPos(high, "y", true));
    }
    isOn = draws;
  };
  for (let row = from; row <= to; row += 1) {
    const at = Math.floor((times[row] - min) * scale);
    if (at !== column) {
      finish();
      [column, low, high] = [at, Infinity, -Infinity];
    }
    if (values[row] < low) low = values[row];
    if (values[row] > high) high = values[row];
  }
  finish();
  return { stroke, fill: null, clip: null, band: null, gaps: null, flags: 0 };
}

function niceStep(least) {
  const power = 10 ** Math.floor(Math.log10(least));
  return power * [1, 2, 5, 10].find((factor) => factor * power >= least * 0.999);
}

function forces(min, max) {
  const step = niceStep((max - min) / 6.5);
  const splits = [];
  for (let k = Math.ceil(min / step); k * step <= max + 1e-9; k += 1) splits.push(k * step);
  return splits;
}

function minus(number) {
  return String(Number(number.toFixed(6))).replace("-", "−");
}

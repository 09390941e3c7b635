// The plot of a recording: as the live one, with the recording's own times, and one force axis for all recordings.

import { clock } from "./player.js";
import { ForcePlot } from "./plot.js";

const STEPS = [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10];

export class TapePlot extends ForcePlot {
  /** Set the ends of the force axis. */
  setRange(bottom, top) {
    [this._bottom, this._top] = [bottom, top];
  }

  _fit() {}

  _splits(min, max) {
    const step = STEPS.find((each) => (max - min) / each <= 6) ?? max - min;
    this._digits = step < 0.1 ? 2 : step < 1 ? 1 : 0;
    const splits = [];
    for (let k = Math.ceil(Math.max(0, min) / step - 1e-6); k * step <= max + 1e-6; k += 1) splits.push(k * step);
    return splits;
  }

  _ago(time) {
    return clock(time + 1e-6, this._digits);
  }
}

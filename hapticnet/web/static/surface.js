// Shape of the tissue around the needle. Pure geometry in metres: x across, y into the tissue.

/** Width of the dent [m]; the server knows only its depth at the needle, so the shape is a drawing. */
const DENT_M = 0.0085;
const LIP_M = 0.0022;
const LIP_DEPTH_M = 0.0011;

/** Depth of a dent at distance `x` from a needle of radius `radius`, relative to its depth at the needle. */
export function dent(x, radius, width = DENT_M) {
  const r = Math.max(0, Math.abs(x) - radius) / width;
  return 1 / (1 + r + r * r);
}

/** Depth [m] of a surface at `x`, from its rest position and its displacement at the needle. */
export function surfaceAt(x, restM, displacementM, pierced, radius) {
  const lip = pierced ? LIP_DEPTH_M * dent(x, radius, LIP_M) : 0;
  return restM + displacementM * dent(x, radius) + lip;
}

/** Places [m] at which to evaluate a surface: dense near the needle, symmetric, from -half to half. */
export function stations(half, count = 34) {
  const places = [];
  for (let k = -count; k <= count; k += 1) places.push(Math.sign(k) * half * (Math.abs(k) / count) ** 2.2);
  return places;
}

/**
 * A surface that springs back after a breach. The oscillation is an ornament, as the scene has none: it lasts 0.4 s
 * and is left out if the reader prefers reduced motion.
 */
export class Spring {
  constructor() {
    this._from = 0;
    this._start = -Infinity;
  }

  release(displacementM, nowMs) {
    this._from = displacementM;
    this._start = nowMs;
  }

  /** Displacement [m] to add to the true one. */
  at(nowMs) {
    const age = (nowMs - this._start) / 1000;
    return age < 0.4 ? this._from * Math.exp(-age / 0.075) * Math.cos(2 * Math.PI * age * 6.5) * (1 - age / 0.4) : 0;
  }
}

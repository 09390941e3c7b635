// The held force as the rumble of a game controller, or the vibration of a phone: substitutions, each off until turned on.
//
// Law: the strength is the share of the just noticeable differences (JND) between no force and the largest one that lie
// below the force, ln(1 + F/F₀) / ln(1 + F₁/F₀) with F₀ = floor / Weber fraction (0.5 N) and F₁ = 4.6 N: each JND of the
// force is about the same step, there is nothing below one JND, and never more than 1. How strongly a motor answers is its
// maker's choice, so the steps are not calibrated. A phone knows on and off only: it is on for that share of the time.

const EVERY_MS = 60; // motors need some tens of milliseconds to follow
const LASTS_MS = 150; // a frozen page is silent after this
const PULSE_MS = 100;
const LEAST_PULSE_MS = 10; // shorter ones start no motor

export const WHAT_IT_IS_NOT = {
  rumble: "A rumble says how strong the contact is, not its direction, and comes tens of milliseconds late.",
  vibrate: "A vibration says how strong the contact is, not its direction, and comes up to 0.1 s late.",
};

/** Strength from 0 to 1 of a force of this size. */
export function strengthOf(forceN, { weber_fraction: weber, floor_n: floorN }, largestN) {
  const size = Math.abs(forceN);
  if (!(size > floorN) || !(weber > 0 && floorN > 0)) return 0;
  const scaleN = floorN / weber;
  return Math.min(1, Math.log1p(size / scaleN) / Math.log1p(largestN / scaleN));
}

class Substitution {
  constructor() {
    this.isOn = false;
    this._sentMs = -Infinity;
    this._was = 0;
  }

  toggle() {
    this.isOn = !this.isOn;
    if (!this.isOn) this._stop();
  }

  /** Follow a strength; called for each frame. */
  follow(strength, nowMs) {
    if (!this.isOn || nowMs - this._sentMs < this._everyMs) return;
    if (strength > 0) this._play(strength);
    else if (this._was > 0) this._stop();
    this._was = strength;
    this._sentMs = nowMs;
  }

  _stop() {
    this._was = 0;
    this._silence();
  }
}

export class Rumble extends Substitution {
  _everyMs = EVERY_MS;

  /** The motors of a connected controller, or undefined. */
  static motors() {
    return [...(navigator.getGamepads?.() ?? [])].find((each) => each?.vibrationActuator)?.vibrationActuator;
  }

  _play(strength) {
    const effect = { duration: LASTS_MS, strongMagnitude: strength, weakMagnitude: strength };
    Rumble.motors()?.playEffect("dual-rumble", effect)?.catch?.(() => {}); // it was unplugged
  }

  _silence() {
    Rumble.motors()?.reset?.()?.catch?.(() => {});
  }
}

export class Vibration extends Substitution {
  _everyMs = PULSE_MS;

  static isThere() {
    return "vibrate" in navigator && matchMedia("(pointer: coarse)").matches;
  }

  _play(strength) {
    navigator.vibrate(Math.max(LEAST_PULSE_MS, Math.round(PULSE_MS * strength)));
  }

  _silence() {
    navigator.vibrate(0);
  }
}

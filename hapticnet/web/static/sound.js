// The held force as a tone: sensory substitution, for those who have no device at hand.

const BASE_HZ = 120;
const HZ_PER_N = 160;
const LOUDEST = 0.12;
const FULL_VOLUME_N = 1.5;
const GLIDE_S = 0.015;

export class Tone {
  constructor() {
    this._context = null;
  }

  get isOn() {
    return this._context?.state === "running";
  }

  /** Start or stop. Call it from a gesture, as browsers require. */
  async toggle() {
    if (!this._context) this._build();
    else if (this.isOn) return this._context.suspend();
    return this._context.resume();
  }

  follow(forceN) {
    if (!this.isOn) return;
    const force = Number.isFinite(forceN) ? Math.abs(forceN) : 0;
    const now = this._context.currentTime;
    this._oscillator.frequency.setTargetAtTime(BASE_HZ + HZ_PER_N * force, now, GLIDE_S);
    this._gain.gain.setTargetAtTime(LOUDEST * Math.min(1, force / FULL_VOLUME_N), now, GLIDE_S);
  }

  _build() {
    this._context = new AudioContext();
    this._oscillator = new OscillatorNode(this._context, { type: "triangle", frequency: BASE_HZ });
    this._gain = new GainNode(this._context, { gain: 0 });
    this._oscillator.connect(this._gain).connect(this._context.destination);
    this._oscillator.start();
  }
}

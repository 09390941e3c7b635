// The held force as a tone, and vibration as it is: sensory substitution, for those who have no device at hand.

const BASE_HZ = 120;
const HZ_PER_N = 160;
const LOUDEST = 0.12;
const FULL_VOLUME_N = 1.5;
const GLIDE_S = 0.015;
const VIBRATION_HZ = 2800;
const FINER = 3; // browsers play 8000 samples a second and more
const FULL_VOLUME_M_S2 = 20;
const AHEAD_S = 0.04; // until the first sample is heard, so that messages may come unevenly
const MOST_AHEAD_S = 0.3;

export class Tone {
  constructor() {
    this._context = null;
    this._endS = 0; // when what waits of the vibration has been heard
    this._lastMS2 = 0;
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

  /** Hear accelerations [m/s²], after those of the call before, at most as loud as the tone. */
  vibrate(samples) {
    if (!this.isOn || !samples.length || this._endS > this._context.currentTime + MOST_AHEAD_S) return;
    const buffer = new AudioBuffer({ length: FINER * samples.length, sampleRate: FINER * VIBRATION_HZ });
    const heard = buffer.getChannelData(0);
    for (let index = 0; index < heard.length; index += 1) {
      const sample = samples[Math.floor(index / FINER)];
      const before = index < FINER ? this._lastMS2 : samples[Math.floor(index / FINER) - 1];
      const acceleration = before + ((sample - before) * (1 + (index % FINER))) / FINER;
      heard[index] = LOUDEST * Math.max(-1, Math.min(1, acceleration / FULL_VOLUME_M_S2));
    }
    this._lastMS2 = samples[samples.length - 1];
    const source = new AudioBufferSourceNode(this._context, { buffer });
    source.connect(this._context.destination);
    const begins = Math.max(this._context.currentTime + AHEAD_S, this._endS);
    source.start(begins);
    this._endS = begins + buffer.duration;
  }

  _build() {
    this._context = new AudioContext();
    this._oscillator = new OscillatorNode(this._context, { type: "triangle", frequency: BASE_HZ });
    this._gain = new GainNode(this._context, { gain: 0 });
    this._oscillator.connect(this._gain).connect(this._context.destination);
    this._oscillator.start();
  }
}

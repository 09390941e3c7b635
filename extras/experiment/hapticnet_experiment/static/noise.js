// White noise that covers the sound of the device, which would tell the force. Off until it is switched on.

const SECONDS = 10; // of the loop: too long to hear that it repeats
const DEVIATION = 0.25; // so that one sample in 16,000 is clipped
const GLIDE_S = 0.05;

export class MaskingNoise {
  /** @param {object} on `changed(level)`: a share of full scale, 0 when it is off */
  constructor({ changed }) {
    this._changed = changed;
    this._context = null;
    this._isOn = false;
    this._button = document.getElementById("noise");
    this._slider = document.getElementById("noise-level");
    this._button.hidden = false;
    this._button.addEventListener("click", () => (this._isOn ? this.stop() : this.start()));
    this._slider.addEventListener("input", () => this._apply());
    this._slider.addEventListener("change", () => this._tell());
  }

  /** Start with the first press of a key or pointer: before it, browsers play nothing. */
  startWithFirstPress() {
    const start = (event) => {
      for (const type of ["pointerdown", "keydown"]) removeEventListener(type, start, true);
      if (!this._button.contains(event.target)) this.start();
    };
    for (const type of ["pointerdown", "keydown"]) addEventListener(type, start, true);
  }

  start() {
    if (!this._context) this._build();
    this._context.resume();
    this._isOn = true;
    this._show();
  }

  stop() {
    if (!this._isOn) return;
    this._isOn = false;
    this._show();
  }

  _show() {
    this._button.ariaPressed = String(this._isOn);
    this._slider.hidden = !this._isOn;
    this._apply();
    this._tell();
  }

  _apply() {
    const level = this._isOn ? Number(this._slider.value) : 0;
    this._gain.gain.setTargetAtTime(level, this._context.currentTime, GLIDE_S);
  }

  _tell() {
    this._changed(this._isOn ? Number(this._slider.value) : 0);
  }

  _build() {
    this._context = new AudioContext();
    const rate = this._context.sampleRate;
    const buffer = new AudioBuffer({ length: SECONDS * rate, sampleRate: rate });
    buffer.copyToChannel(gaussian(SECONDS * rate), 0);
    const source = new AudioBufferSourceNode(this._context, { buffer, loop: true });
    this._gain = new GainNode(this._context, { gain: 0 });
    source.connect(this._gain).connect(this._context.destination);
    source.start();
  }
}

/** Samples of white Gaussian noise (Box and Muller). */
export function gaussian(count) {
  const samples = new Float32Array(count);
  for (let k = 0; k < count; k += 1) {
    const radius = DEVIATION * Math.sqrt(-2 * Math.log(1 - Math.random()));
    samples[k] = Math.max(-1, Math.min(1, radius * Math.cos(2 * Math.PI * Math.random())));
  }
  return samples;
}

// The time that a replay shows, and its controls: play and pause, seek, speed, loop, and their keys.

const SPEEDS = [0.1, 0.25, 0.5, 1, 1.5, 2, 4];
const LONGEST_STEP_S = 0.5; // a page that was hidden goes on where it was
const STEPS_S = { ArrowLeft: -1, ArrowRight: 1 };
const LARGE_S = { PageDown: -10, PageUp: 10 }; // on the slider only: elsewhere these keys scroll
const FINE = 0.1; // of a step, with Shift

const byId = (id) => document.getElementById(id);

export class Player {
  /** @param {object} on `seek()` after a jump, and `say(text)` for screen readers */
  constructor(on) {
    this._on = on;
    this._loop = false;
    this._speed = 1;
    this._lastMs = null;
    this._shown = null;
    this.timeS = 0;
    this.durationS = 0;
    this.isPlaying = false;
    byId("play").addEventListener("click", () => this.toggle());
    byId("loop").addEventListener("click", () => this.setLoop(!this._loop));
    byId("seek").addEventListener("input", ({ target }) => this.seek(Number(target.value)));
    byId("speed").addEventListener("change", ({ target }) => this.setSpeed(Number(target.value)));
    addEventListener("keydown", (event) => this._press(event));
  }

  /** Start as the server's hello says; after a lost connection, continue at the same time. */
  configure({ duration_s: durationS, speed, loop }) {
    const isFirst = this.durationS === 0;
    this.durationS = durationS;
    byId("seek").max = durationS;
    for (const id of ["play", "seek", "speed", "loop"]) byId(id).disabled = false;
    if (!isFirst) return;
    const speeds = [...new Set([...SPEEDS, speed])].sort((a, b) => a - b);
    byId("speed").replaceChildren(...speeds.map((each) => new Option(`${each} ×`, each)));
    this.setSpeed(speed);
    this.setLoop(loop);
    // With reduced motion preferred, it waits for a press of Play.
    if (!matchMedia("(prefers-reduced-motion: reduce)").matches) this.play();
    this._show();
  }

  toggle() {
    if (this.isPlaying) this.pause();
    else this.play();
    this._on.say(this.isPlaying ? "Playing" : `Paused at ${spoken(this.timeS)}`);
  }

  play() {
    if (this.timeS >= this.durationS) this.seek(0);
    this.isPlaying = true;
    this._label();
  }

  pause() {
    this.isPlaying = false;
    this._label();
  }

  seek(timeS) {
    this.timeS = Math.min(this.durationS, Math.max(0, timeS));
    this._on.seek();
    this._show();
  }

  setSpeed(speed) {
    this._speed = speed;
    byId("speed").value = String(speed);
  }

  setLoop(loop) {
    this._loop = loop;
    byId("loop").ariaPressed = String(loop);
  }

  get speed() {
    return this._speed;
  }

  /** Go on, if what comes next is there. */
  advance(nowMs, isReady) {
    const stepS = this._lastMs === null ? 0 : Math.min(LONGEST_STEP_S, (nowMs - this._lastMs) / 1000);
    this._lastMs = nowMs;
    if (this.isPlaying && isReady) {
      this.timeS += stepS * this._speed;
      if (this.timeS >= this.durationS) this._end();
    }
    this._show();
  }

  _end() {
    if (this._loop && this.durationS > 0) {
      this.seek(0);
      return;
    }
    this.timeS = this.durationS;
    this.pause();
    this._on.say("The recording has ended");
  }

  _press(event) {
    if (event.ctrlKey || event.metaKey || event.altKey || byId("play").disabled) return;
    const { target, key } = event;
    const isControl = target.closest?.("button, select, a");
    if (key === " " && isControl) return; // it presses that
    if (target.closest?.("select")) return;
    const step = STEPS_S[key] ?? (target.id === "seek" ? LARGE_S[key] : null) ?? null;
    if (key === " ") this.toggle();
    else if (step !== null) this.seek(this.timeS + step * (event.shiftKey ? FINE : 1));
    else if (key === "Home") this.seek(0);
    else if (key === "End") this.seek(this.durationS);
    else if (key.toLowerCase() === "l") this.setLoop(!this._loop);
    else return;
    event.preventDefault();
  }

  _label() {
    byId("play").textContent = this.isPlaying ? "Pause" : "Play";
  }

  _show() {
    const words = `${clock(this.timeS)} / ${clock(this.durationS)}`;
    if (words === this._shown) return;
    this._shown = words;
    const slider = byId("seek");
    slider.value = this.timeS;
    slider.style.setProperty("--share", `${this.durationS ? (100 * this.timeS) / this.durationS : 0}%`);
    slider.ariaValueText = `${spoken(this.timeS)} of ${spoken(this.durationS)}`;
    byId("time").textContent = words;
  }
}

/** A time as 1:02:03.4. */
export function clock(timeS, digits = 1) {
  const unit = 10 ** digits;
  const whole = Math.floor(Math.max(0, timeS) * unit + 1e-6);
  const [minutes, seconds] = [Math.floor(whole / (60 * unit)), (whole % (60 * unit)) / unit];
  const two = (number) => String(number).padStart(2, "0");
  const head = minutes < 60 ? `${minutes}` : `${Math.floor(minutes / 60)}:${two(minutes % 60)}`;
  return `${head}:${seconds.toFixed(digits).padStart(digits ? 3 + digits : 2, "0")}`;
}

function spoken(timeS) {
  const minutes = Math.floor(timeS / 60);
  const seconds = `${(timeS - 60 * minutes).toFixed(1)} seconds`;
  return minutes ? `${minutes} ${minutes === 1 ? "minute" : "minutes"} ${seconds}` : seconds;
}

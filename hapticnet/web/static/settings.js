// The settings form: sends changes, and shows what the server reports.

import { codecWords, thresholdWords } from "./words.js";

const SEND_EVERY_MS = 120;
const SETTLE_MS = 800; // while a person turns a control, reports of older values must not move it back
const UNITS = { multiplier: (value) => `${value} JND`, delay_ms: (value) => `${value} ms`, loss_percent: (value) => `${value} %` };

export class Settings {
  /** @param {function} send called with an object of changes */
  constructor(form, send) {
    this._form = form;
    this._send = send;
    this._touchedMs = new Map();
    this._changes = {};
    this._timer = null;
    this._state = null;
    this._summaries = new Map();
    form.addEventListener("submit", (event) => event.preventDefault());
    form.addEventListener("input", ({ target }) => this._input(target));
  }

  /** Take over what the server offers: codecs, limits, and what may be changed. */
  configure({ codecs, limits, adjustable }) {
    const list = this._form.elements.codec;
    this._summaries = new Map(codecs.map(({ name, summary }) => [name, summary]));
    list.replaceChildren(...codecs.map(({ name }) => new Option(name)));
    for (const name of [...Object.keys(UNITS), "codec"]) {
      const input = this._form.elements[name];
      input.disabled = !adjustable.includes(name);
      input.closest(".field").title = input.disabled ? "This run does not let a page change it" : "";
    }
    for (const [name, [low, high]] of Object.entries(limits)) {
      const input = this._form.elements[name];
      if (input) [input.min, input.max] = [low, high];
    }
  }

  /** Show a state of the server. */
  show(state) {
    this._state = state;
    const nowMs = performance.now();
    for (const name of [...Object.keys(UNITS), "codec"]) {
      const input = this._form.elements[name];
      const settled = nowMs - (this._touchedMs.get(name) ?? -Infinity) > SETTLE_MS;
      if (!settled) continue;
      const value = String(state[name]);
      if (name === "codec" && !this._summaries.has(value)) input.add(new Option(value));
      if (input.value !== value) input.value = value;
      if (input.type === "range") this._label(input, state[name]);
    }
    this._explain();
  }

  enable(enabled) {
    this._form.inert = !enabled;
  }

  /** A change was refused: show the server's values again. */
  refused() {
    this._touchedMs.clear();
    if (this._state) this.show(this._state);
  }

  _input(target) {
    const value = target.type === "range" ? Number(target.value) : target.value;
    this._touchedMs.set(target.id, performance.now());
    this._changes[target.id] = value;
    if (target.type === "range") this._label(target, value);
    this._explain();
    this._timer ??= setTimeout(() => {
      this._timer = null;
      this._send(this._changes);
      this._changes = {};
    }, SEND_EVERY_MS);
  }

  _label(input, value) {
    const share = (Number(input.value) - input.min) / (input.max - input.min);
    input.style.setProperty("--share", `${100 * share}%`);
    const text = UNITS[input.id](Number(value.toPrecision(4)));
    input.ariaValueText = text;
    this._form.querySelector(`output[for="${input.id}"]`).textContent = text;
  }

  _explain() {
    const { multiplier, codec } = this._form.elements;
    this._text("codec-help", codecWords(codec.value, this._summaries.get(codec.value)));
    this._text("delay-help", `adds ${2 * this._form.elements.delay_ms.value} ms to the round trip`);
    if (!this._state) return;
    const { weber_fraction: fraction, floor_n: floor } = this._state;
    const raw = codec.value === "raw";
    this._text("multiplier-help", raw ? "Raw sends every sample" : thresholdWords(Number(multiplier.value), fraction, floor));
  }

  _text(id, text) {
    const box = document.getElementById(id);
    if (box.textContent === text) return;
    box.textContent = text;
    box.title = text;
  }
}

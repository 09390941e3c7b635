// One recording on the page: its scene, forces, traffic and settings at a time.

import { Blocks } from "./blocks.js";
import { clock } from "./player.js";
import { SceneView } from "./scene.js";
import { SpaceView } from "./space.js";
import { TapePlot } from "./tapeplot.js";
import { bytes, count, newtons, percent, sceneWords, spaceWords } from "./words.js";

const AHEAD_S = 2; // loaded before it is shown, at speed 1
const TRAIL_S = 2.5; // of the tool's path that a jump brings back
const NEWS_S = 20;
const WORDS_EVERY_MS = 1000;
const LEGEND_EVERY_MS = 120;
const LINES = ["true", "held", "sensed", "band"];

export class TapeView {
  /**
   * @param {HTMLElement} box where it goes
   * @param {number} number of the recording
   * @param {object} about its description from the server
   * @param {object} with `historyS`, `bottomN`, `topN`, `ask`, and `onEnlarge()` when a part of the plot is enlarged
   */
  constructor(box, number, about, { historyS, bottomN, topN, ask, onEnlarge }) {
    this._about = about;
    this._historyS = historyS;
    this._root = document.getElementById("tape").content.firstElementChild.cloneNode(true);
    box.append(this._root);
    this._name = about.label ? `Recording ${about.label}` : "Recording";
    this.blocks = new Blocks(number, about, ask);
    this._describe();
    this._canvas = this._find("canvas");
    this._scene = new SceneView(this._canvas);
    this._space = new SpaceView(this._canvas);
    this._message = null; // of the scene that is shown
    this._frame = -1;
    this._key = "";
    this._data = null;
    this._wordsMs = this._legendMs = 0;
    this._figures = null;
    this._plot = new TapePlot(this._find(".chart"), historyS, (paused) => paused && onEnlarge());
    this._plot.setRange(bottomN, topN);
    this._showLines();
  }

  /** Whether what is shown at a time [s] of the page is there. */
  isReady(timeS) {
    return this.blocks.has(timeS - this._about.begin_s);
  }

  /** Forget what moved: the next time is not the one after the last. */
  jump() {
    this._frame = -1;
    this._message = null;
    this._wordsMs = this._legendMs = 0;
    this.resume();
  }

  /** Let the plot follow the time again. */
  resume() {
    this._plot.setPaused(false);
  }

  /** Show a time [s] of the page. */
  draw(timeS, speed, nowMs) {
    const at = timeS - this._about.begin_s;
    const before = Math.max(this._historyS, TRAIL_S);
    const blocks = this.blocks.between(at - before, at + AHEAD_S * Math.max(1, speed), at, nowMs);
    this._showScene(at, blocks);
    this._collect(blocks);
    this._show(at, timeS, nowMs);
  }

  /** Show traffic and felt error as the server has worked them out; null before the recording begins. */
  showFigures(figures) {
    const traffic = figures?.traffic;
    const absent = figures && !traffic ? "not recorded" : "";
    if (traffic) {
      this._tile("packets", count(traffic.packets_per_s), "/s", ratio(traffic.packets_per_s, traffic.raw_packets_per_s),
        `of ${count(traffic.raw_packets_per_s)} uncompressed`);
      const [size, unit] = bytes(traffic.bytes_per_s);
      this._tile("bytes", size, `${unit}/s`, ratio(traffic.bytes_per_s, traffic.raw_bytes_per_s),
        `of ${bytes(traffic.raw_bytes_per_s).join(" ")} uncompressed`);
      const left = ratio(traffic.packets, traffic.raw_packets);
      const leftBytes = ratio(traffic.bytes, traffic.raw_bytes);
      this._tile("saved", left === null ? "–" : percent(Math.max(0, 1 - left)), left === null ? "" : "%", left === null ? null : 1 - left,
        left === null ? "no force yet" : `bytes: ${percent(Math.max(0, 1 - leftBytes))} %, while felt`);
    } else for (const name of ["packets", "bytes", "saved"]) this._tile(name, "–", "", null, absent);
    const felt = figures?.felt;
    if (felt) {
      this._tile("felt", percent(felt.exceed_jnd_fraction), "%", felt.exceed_jnd_fraction,
        `of 5 s; so far ${percent(felt.so_far ?? 0)} %; RMSE ${felt.rmse_n.toFixed(2)} N`);
    } else this._tile("felt", "–", "", null, figures ? "not known here" : "");
    this._figures = figures;
  }

  _find(selector) {
    return this._root.querySelector(selector);
  }

  _describe() {
    const { label, name, spans, begin_s: beginS } = this._about;
    const changes = spans.slice(1).map(({ t_s: timeS }) => clock(beginS + timeS));
    const more = changes.length > 5 ? ` and ${changes.length - 5} times more` : "";
    const notes = [...this._about.notes, ...(changes.length ? [`settings changed at ${changes.slice(0, 5).join(", ")}${more}; those in force stand below`] : [])];
    this._root.ariaLabel = this._name;
    this._find("h2").textContent = label ? `${label}: ${name}` : name;
    this._find(".about").textContent = aboutWords(this._about);
    this._find(".notes").replaceChildren(...notes.map((note) => {
      const item = document.createElement("li");
      item.textContent = note;
      return item;
    }));
    this._find(".notes").hidden = notes.length === 0;
    if (this._about.kind === "foreign") this._find('[data-line="true"]').childNodes[1].data = "force"; // the recording does not say whose
    const named = { ".stage": "scene", ".plot": "forces", ".legend": "lines of the plot", ".tiles": "traffic and felt error" };
    for (const [selector, what] of Object.entries(named)) this._find(selector).ariaLabel = `${this._name}, ${what}`;
    this._find(".chart").ariaLabel = `${this._name}: forces over the five seconds before the time shown`;
  }

  _showLines() {
    const known = new Set(this._about.known);
    const isThere = { true: known.has("true"), held: known.has("held"), sensed: known.has("sensed"), band: known.has("received") && this._about.spans.length > 0 };
    for (const line of LINES) {
      const button = this._find(`[data-line="${line}"]`);
      button.hidden = !isThere[line];
      this._plot.show(line, isThere[line]);
      button.addEventListener("click", () => {
        const visible = button.ariaPressed !== "true";
        button.ariaPressed = String(visible);
        this._plot.show(line, visible);
      });
    }
  }

  /** The newest frame at a time; after a jump also those before, so that the tool has its path. */
  _showScene(at, blocks) {
    const message = this._about.scenes.findLast(({ t_s: fromS }) => fromS <= at) ?? this._about.scenes[0];
    if (message !== this._message) {
      this._message = message;
      this._frame = -1;
      this._scene.setScene(message);
      this._space.clear();
      if (this._about.shapes.length) this._space.setShapes({ count: this._about.shapes.length, changed: this._about.shapes });
      this._space.setScene(message);
    }
    const isFirst = this._frame < 0;
    for (const block of blocks) {
      for (let k = 0; k < block.frames; k += 1) {
        const timeS = block.beginS + block.frameTimes[k];
        if (timeS > at + 1e-6) break;
        if (timeS <= this._frame || timeS < Math.max(message.t_s, isFirst ? at - TRAIL_S : 0)) continue;
        this._frame = timeS;
        this._setFrame(block, k, message);
      }
    }
  }

  _setFrame(block, k, { tissues }) {
    const tip = block.tip.map((column) => column[k]);
    this._push = block.push.map((column) => column[k]);
    this._contacts = block.contacts.slice(0, tissues.length).map((column) => column[k]);
    const surfacesM = block.surfaces.slice(0, tissues.length).map((column) => column[k]);
    // Only the newest frame counts for layers: none is breached by a jump.
    this._next = { tipM: tip[0], surfacesM, contacts: this._contacts };
    this._space.setFrame({ tipM: tip[0], furtherM: tip.slice(1) });
  }

  /** Join the columns of the blocks for the plot. */
  _collect(blocks) {
    const key = `${blocks.map(({ number }) => number).join()}/${this.blocks.version}`;
    if (key === this._key) return;
    this._key = key;
    const rows = blocks.reduce((sum, block) => sum + block.rows, 0);
    const names = this._about.columns;
    const data = { time: new Float64Array(rows) };
    for (const name of [...names.slice(1), "low", "high"]) data[name] = new Float32Array(rows).fill(NaN);
    let at = 0;
    for (const block of blocks) {
      for (let row = 0; row < block.rows; row += 1) data.time[at + row] = block.beginS + block.columns[0][row];
      names.slice(1).forEach((name, index) => data[name].set(block.columns[index + 1], at));
      at += block.rows;
    }
    this._limit(data);
    for (let row = 0; row < rows; row += 1) data.time[row] += this._about.begin_s;
    this._data = data;
  }

  /** Limits of the deadband around the received force, by the settings in force at each time. */
  _limit({ time, received, low, high }) {
    const { spans } = this._about;
    let k = 0;
    for (let row = 0; row < time.length; row += 1) {
      while (k + 1 < spans.length && spans[k + 1].t_s <= time[row]) k += 1;
      const { codec, law } = spans[k] ?? {};
      if (!law || codec === "raw" || !(law.multiplier > 0)) continue;
      const threshold = law.multiplier * jnd(law, received[row]);
      [low[row], high[row]] = [received[row] - threshold, received[row] + threshold];
    }
  }

  _show(at, timeS, nowMs) {
    const { duration_s: durationS, axes, label } = this._about;
    const data = this._data;
    const forceName = this._about.known.includes("held") ? "held" : "true";
    const row = lastUpTo(data.time, timeS);
    const value = (name) => (row < 0 ? NaN : data[name][row]);
    const forceN = Number.isFinite(value(forceName)) ? value(forceName) : null;
    if (this._next) {
      this._scene.setFrame(this._next);
      this._next = null;
    }
    const isSpace = !this._message.known || axes > 1;
    if (isSpace) this._space.draw(nowMs, { forceN: axes > 1 ? (this._push ?? null) : forceN === null ? null : [forceN] });
    else this._scene.draw(nowMs, { forceN });
    const over = this._find(".over");
    const words = at < 0 ? `begins at ${clock(this._about.begin_s)}` : at > durationS + 0.05 ? `ended at ${clock(this._about.begin_s + durationS)}` : "";
    over.hidden = !words;
    if (words && over.textContent !== words) over.textContent = words;
    this._plot.update(timeS, data.time, ["low", "high", "held", "true", "sensed"].map((name) => data[name]), data.packets, nowMs);
    if (nowMs - this._legendMs > LEGEND_EVERY_MS) {
      this._legendMs = nowMs;
      this._showValues(value, at);
    }
    if (nowMs - this._wordsMs < WORDS_EVERY_MS) return;
    this._wordsMs = nowMs;
    const shown = isSpace ? spaceWords(this._space.tip.slice(0, axes), forceN) : sceneWords(this._scene.tipM, this._message.tissues, this._contacts ?? [], forceN);
    this._canvas.ariaLabel = `Scene${label && ` of recording ${label}`}: ${shown}`;
  }

  _showValues(value, at) {
    const { hovered } = this._plot;
    const seen = (name) => (hovered === null ? value(name) : this._plot.value(name, hovered));
    for (const line of ["true", "held", "sensed"]) this._legend(line, newtons(seen(line)));
    const { low, high } = this._plot.band(hovered) ?? { low: value("low"), high: value("high") };
    this._legend("band", Number.isFinite(high - low) ? `±${(500 * (high - low)).toFixed(0)} mN` : "none");
    const span = this._about.spans.findLast(({ t_s: fromS }) => fromS <= at) ?? this._about.spans[0];
    const apart = span && value("error") / jnd(span.law, value("held"));
    const words = Number.isFinite(apart) ? `Held ${newtons(value("held"))}, true ${newtons(value("true"))}: ${apart.toFixed(1)} JND apart`
      : this._about.known.includes("true") ? "" : "The true force is not known here";
    write(this._find(".force"), words);
    const [eventS, ...event] = this._about.events.findLast(([fromS]) => fromS <= at) ?? [-Infinity];
    const news = at - eventS < NEWS_S ? `${clock(eventS + this._about.begin_s)} ${eventWords(...event)}` : "";
    const line = write(this._find(".newest"), [this._about.spans.length ? `In force: ${span.line}` : "", news].filter(Boolean).join(" · "));
    line.title = line.textContent;
  }

  _legend(line, text) {
    write(this._find(`[data-line="${line}"] output`), text);
  }

  _tile(name, number, unit, share, note) {
    const box = this._find(`[data-tile="${name}"]`);
    const [value, small] = box.querySelectorAll(".big > *");
    write(value, number);
    write(small, unit);
    box.querySelector(".bar i").hidden = share === null;
    box.querySelector(".bar i").style.width = `${100 * Math.min(1, Math.max(0, share ?? 0))}%`;
    write(box.querySelector(".quiet"), note);
  }
}

function jnd({ weber_fraction: fraction, floor_n: floor }, forceN) {
  return Math.max(fraction * Math.abs(forceN), floor);
}

function ratio(part, whole) {
  return whole > 0 ? part / whole : null;
}

function write(box, words) {
  if (box.textContent !== words) box.textContent = words;
  return box;
}

/** Index of the last time that is not later; −1 without one. */
function lastUpTo(times, at) {
  let [low, high] = [0, times.length];
  while (low < high) {
    const middle = (low + high) >> 1;
    if (times[middle] <= at + 1e-6) low = middle + 1;
    else high = middle;
  }
  return low - 1;
}

/** What a recording is, in a line. */
function aboutWords({ kind, unix_s: unixS, scenes }) {
  const when = Number.isFinite(unixS) && Math.abs(unixS) < 1e11 ? `${new Date(1000 * unixS).toISOString().slice(0, 16).replace("T", " ")} UTC` : "";
  const scene = scenes.at(-1).name;
  return [kind === "foreign" ? "" : `recorded by a ${kind}`, when, scene && `scene ${scene}`].filter(Boolean).join(" · ");
}

/** An event as its name, and the first of its texts. */
function eventWords(name, text) {
  const words = name.replace(/(?<=[a-z])(?=[A-Z])/g, " ").toLowerCase();
  try {
    const said = Object.values(JSON.parse(text) ?? {}).find((each) => typeof each === "string");
    return said ? `${words}: ${said}` : words;
  } catch {
    return `${words}: ${text}`;
  }
}

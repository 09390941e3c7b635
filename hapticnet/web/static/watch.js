// The watch view: everything there is to see, and the settings.

import { Clock } from "./clock.js";
import { isInGallery, showDemonstration } from "./demonstration.js";
import { History } from "./history.js";
import { ForcePlot, LINES } from "./plot.js";
import { Rumble, Vibration, WHAT_IT_IS_NOT, strengthOf } from "./rumble.js";
import { Settings } from "./settings.js";
import { Tone } from "./sound.js";
import { Stage } from "./stage.js";
import { showTraffic } from "./traffic.js";
import { bandSentence, count, firstSentence, handSentence, linkState, newtons } from "./words.js";

const KEPT = ["true", "received", "held", "sensed", "packets", "low", "high"];
const LEGEND_EVERY_MS = 120;
const MOST_EVENTS = 50;
const NEWS_S = 20;
const LARGEST_N = 4.6; // force of the strongest rumble without a device: what one would press

const byId = (id) => document.getElementById(id);

const clock = new Clock();
const tone = new Tone();
const substitutions = { rumble: new Rumble(), vibrate: new Vibration() };
const shown = new Map(LINES.map((line) => [line, true]));
let history = new History(KEPT, 5000);
let columns = [];
let about = []; // what the header says about the run
let scene = null;
let largestN = null; // what the device renders at most
let newestS = null; // time of the newest event, while it is shown
let law = null; // multiplier, weber_fraction, floor_n of the newest state
let person = null; // the newest state, whose weber_fraction and floor_n are the person's even where nothing is compressed
let plot = null;
let legendMs = 0;

if (isInGallery) showDemonstration(byId("demonstration"));

const stage = new Stage("watch", {
  hello: configure,
  scene: (message) => {
    scene = message;
    byId("about").textContent = [message.name && `scene ${message.name}`, ...about].filter(Boolean).join(" · ");
    describe();
  },
  shapes: describe,
  hand: describe,
  samples: takeSamples,
  vibration: ({ playedMS2 }) => tone.vibrate(playedMS2),
  state: showState,
  event: showEvent,
  error: () => settings.refused(),
  lost: () => {
    settings.enable(false);
    clock.reset();
  },
  draw: drawFrame,
  forceN: () => history.last("held"),
});

const settings = new Settings(byId("settings"), (changes) => stage.connection.send("set", changes));
settings.enable(false);

function configure(hello) {
  columns = [...hello.columns, "low", "high"];
  history = new History(KEPT, Math.ceil(hello.rate_hz * (hello.history_s + 0.5)));
  clock.reset();
  law = null;
  largestN = hello.largest_n;
  plot ??= makePlot(hello.history_s);
  settings.configure(hello);
  settings.enable(true);
  const link = byId("operator-link");
  link.hidden = !hello.operator_url || isInGallery; // its address is of this machine alone
  if (hello.operator_url) link.href = hello.operator_url;
  document.querySelector('[data-line="sensed"]').hidden = hello.device === null;
  plot.show("sensed", hello.device !== null && shown.get("sensed"));
  byId("event-list").querySelector("ol").replaceChildren();
  about = [`${count(hello.rate_hz)} Hz`, hello.device && `device ${hello.device}`];
}

function describe() {
  if (!scene) return;
  write("first", firstSentence(scene, stage.space.words()));
  write("who", handSentence(stage.source, stage.holder, stage.isSpace ? "tool" : "needle"));
  document.querySelector('[data-line="true"]').hidden = !scene.known; // nobody here knows it
}

function write(id, words) {
  if (byId(id).textContent !== words) byId(id).textContent = words;
}

function makePlot(seconds) {
  const button = byId("pause");
  const made = new ForcePlot(byId("plot"), seconds, (paused) => {
    button.ariaPressed = String(paused);
  });
  button.addEventListener("click", () => made.setPaused(!made.isPaused));
  return made;
}

/** Add the limits of the deadband around the received force, by the law at the time, and keep the samples. */
function takeSamples(message) {
  const received = message.columns[columns.indexOf("received")];
  const low = new Float32Array(message.rows).fill(NaN);
  const high = new Float32Array(message.rows).fill(NaN);
  if (law && received) {
    received.forEach((force, row) => {
      const threshold = law.multiplier * Math.max(law.weber_fraction * Math.abs(force), law.floor_n);
      low[row] = force - threshold;
      high[row] = force + threshold;
    });
  }
  message.columns.push(low, high);
  history.append(message, columns);
  clock.observe(history.lastTime, performance.now() / 1000);
}

function showState(state) {
  person = state;
  byId("rumble").hidden = !Rumble.motors();
  byId("vibrate").hidden = !Vibration.isThere();
  law = state.codec === "raw" || !(state.multiplier > 0) ? null : state;
  const [level, words] = linkState(state.link);
  stage.setLink(level, words);
  byId("link-state").title = `${state.sealed ? "Sealed" : "Open"} session, connected ${state.connections} times`;
  const device = byId("device-state");
  device.hidden = !state.device;
  if (state.device) {
    device.dataset.level = state.device === "ready" ? "good" : "info";
    device.querySelector("b").textContent = `Device ${state.device}`;
  }
  settings.show(state);
  showTraffic(state);
  write("band-words", bandSentence(state.codec));
  stage.setSwings(state.port?.swings ?? false);
  stage.setLimit(largestN !== null && history.last("held") > largestN + 0.05 ? Number(largestN.toFixed(2)) : null);
  showAge(state.t_s);
}

function showEvent({ t_s: time, text }) {
  const list = byId("event-list").querySelector("ol");
  const item = document.createElement("li");
  const when = document.createElement("time");
  when.textContent = `${time.toFixed(1)} s`;
  item.append(when, text);
  list.prepend(item);
  while (list.children.length > MOST_EVENTS) list.lastChild.remove();
  newestS = time;
  byId("newest").title = byId("newest").textContent = text;
}

/** An event is news for a while; then it is in the list only. */
function showAge(nowS) {
  if (newestS === null || nowS - newestS < NEWS_S) return;
  newestS = null;
  byId("newest").title = byId("newest").textContent = "";
}

function drawFrame(nowMs) {
  const heldN = history.last("held");
  tone.follow(heldN);
  const strength = person && stage.connection.isOpen && !document.hidden ? strengthOf(heldN, person, largestN ?? LARGEST_N) : 0;
  for (const each of Object.values(substitutions)) each.follow(strength, nowMs);
  const edge = clock.now(nowMs / 1000);
  if (!plot || !Number.isFinite(edge)) return;
  const forces = ["low", "high", "held", "true", "sensed"].map((name) => history.column(name));
  plot.update(edge, history.time, forces, history.column("packets"), nowMs);
  if (nowMs - legendMs < LEGEND_EVERY_MS) return;
  legendMs = nowMs;
  showValues();
}

function showValues() {
  const hovered = plot.hovered;
  const at = (name) => (hovered === null ? history.last(name) : plot.value(name, hovered));
  for (const line of ["true", "held", "sensed"]) legendValue(line, newtons(at(line)));
  const { low, high } = plot.band(hovered) ?? { low: history.last("low"), high: history.last("high") };
  const threshold = (high - low) / 2;
  legendValue("band", Number.isFinite(threshold) ? `±${(1000 * threshold).toFixed(0)} mN` : "none");
}

function legendValue(line, text) {
  document.querySelector(`[data-line="${line}"] output`).textContent = text;
}

function showLine(line, visible) {
  document.querySelector(`[data-line="${line}"]`).ariaPressed = String(visible);
  shown.set(line, visible);
  plot?.show(line, visible);
}

for (const button of document.querySelectorAll("[data-line]")) {
  button.addEventListener("click", () => showLine(button.dataset.line, !shown.get(button.dataset.line)));
}

byId("sound").addEventListener("click", async () => {
  await tone.toggle();
  byId("sound").ariaPressed = String(tone.isOn);
});

for (const [name, substitution] of Object.entries(substitutions)) {
  byId(name).addEventListener("click", () => {
    substitution.toggle();
    byId(name).ariaPressed = String(substitution.isOn);
    if (substitution.isOn) stage.tell(WHAT_IT_IS_NOT[name]);
  });
}

// Texts and numbers for people. Pure functions.

import { texts } from "./texts.js";

/** A force as text, or a dash where it is not known. */
export function newtons(forceN, digits = 2) {
  return Number.isFinite(forceN) ? `${signed(forceN, digits)} N` : "–";
}

/** A number with a true minus sign, and without "−0.00". */
export function signed(number, digits) {
  const text = Math.abs(number).toFixed(digits);
  return number < 0 && Number(text) !== 0 ? `−${text}` : text;
}

/** A count with thousands separated. */
export function count(number) {
  return Math.round(number).toLocaleString("en");
}

/** A data rate or amount: number and unit, apart, so that they can be set in different sizes. */
export function bytes(number) {
  if (number < 1000) return [count(number), "B"];
  if (number < 999_950) return [(number / 1000).toFixed(number < 9950 ? 1 : 0), "kB"];
  return [(number / 1e6).toFixed(1), "MB"];
}

/** An energy: number and unit, apart. */
export function joules(number) {
  return number < 0.9995 ? [(1000 * number).toFixed(number < 0.00995 ? 1 : 0), "mJ"] : [number.toPrecision(3), "J"];
}

/** A share of one in percent, with more digits where it is near nothing or near everything. */
export function percent(share) {
  const value = 100 * share;
  return Math.min(value, 100 - value) < 9.95 && value > 0 && value < 100 ? value.toFixed(1) : value.toFixed(0);
}

const LINKS = {
  established: ["good", "Connected"],
  connecting: ["wait", "Looking for the slave"],
  stale: ["warn", "Link stale"],
  closing: ["wait", "Closing"],
  closed: ["bad", "Closed"],
};

/** Level and words of the link between master and slave. */
export function linkState(link) {
  return LINKS[link] ?? ["info", link];
}

const SOURCES = { scripted: "A script moves the needle", trace: "A recording moves the needle", hand: "A simulated hand moves the needle" };

/** What the line under the scene says about the hand. */
export function handWords(source, holder, state) {
  if (source !== "page") return SOURCES[source] ?? `The needle is moved by ${source}`;
  if (holder === "you") return state === "holding" ? texts.waiting : texts.yours;
  if (holder === "another") return "Another page moves the needle";
  return state === "withdrawing" ? texts.withdrawing : texts.free;
}

const WAYS = ["Drag down to push, or use ↑ ↓.", "Drag, or use ↑ ↓ ← →.", "Drag, or use ↑ ↓ ← →; wheel or W and S: away and back."];
const TOUCHES = ["Drag down to push.", "Drag to push.", "Drag to push; with two fingers, up and down: away and back."];
const STICKS = ["the stick", "the stick", "both sticks"];

export function hint(source, holder, { speed_m_per_s: speed, delay_ms: delay, axes = 1 }) {
  if (source !== "page") return "This page watches.";
  if (holder === "another") return "You watch until that page lets go.";
  if ([...(navigator.getGamepads?.() ?? [])].some((each) => each?.connected)) return `Drag, or use ${STICKS[axes - 1]}: the first button takes the hand, the second lets go.`;
  const how = matchMedia("(pointer: coarse)").matches ? TOUCHES[axes - 1] : `${WAYS[axes - 1]} Esc lets go.`;
  return `${how} It follows ${delay} ms later, at up to ${count(speed * 1000)} mm/s.`;
}

/** The scene in words, for screen readers. */
export function sceneWords(tipM, tissues, contacts, forceN) {
  const parts = [`${(tipM * 1000).toFixed(0)} millimetres deep`];
  tissues.forEach(({ name }, index) => {
    const what = name ?? `tissue ${index + 1}`;
    if (contacts[index] === 1) parts.push(`pressing on ${what}`);
    if (contacts[index] === 2) parts.push(`${what} breached`);
  });
  if (Number.isFinite(forceN)) parts.push(`${forceN.toFixed(1)} newtons`);
  return parts.join(", ");
}

/** A scene without tissues in words, for screen readers. */
export function spaceWords(tipM, forceN) {
  const place = tipM.map((each) => signed(each * 1000, 0)).join(", ");
  return `Tool at ${place} millimetres${Number.isFinite(forceN) ? `, ${forceN.toFixed(1)} newtons` : ""}`;
}

const MOST_NAMES = 3;
const WHERE = ["one axis", "two axes", "three axes"];

/**
 * The first sentence for somebody who sees the page: what there is, and what it does.
 * @param {object} scene the newest message of that type
 * @param {string} shapes what the scene says of its looks, in words; empty if nothing
 */
export function firstSentence({ known, axes, tissues, name, parts = [] }, shapes) {
  const others = parts.length > 1 ? ` It has ${parts.length} parts; you see the first, ${parts[0].replace("@", " at ")}.` : "";
  if (known && axes === 1) {
    const named = tissues.map((each) => each.name).filter((each) => each && !/^tissue \d+$/.test(each));
    const names = named.length && named.length <= MOST_NAMES ? ` (${named.join(", ")})` : "";
    const layers = tissues.length === 1 ? `one layer of tissue${names}; it` : `${tissues.length} layers of tissue${names}; each`;
    return `A needle, elsewhere on the network, enters ${layers} pushes back until it breaks.${others}`;
  }
  const model = name?.startsWith("mujoco:") ? " of a MuJoCo model" : "";
  const tool = `A tool, elsewhere on the network, moves on ${WHERE[axes - 1]}`;
  return (shapes ? `${tool} among ${shapes}${model}; what it touches pushes back, as the arrow shows.`
    : `${tool}, in a scene that does not say how it looks: you see the tool, its path and the force on it.`) + others;
}

const HANDS = {
  page: { you: "The ring is your hand; the {} follows it.", another: "A hand on another page moves it.", nobody: "Your hand is a ring that the {} follows: drag it." },
  scripted: "A script is the hand.",
  trace: "A recording is the hand.",
  hand: "The hand is simulated: it wants to move on, and the force pushes it back.",
};

/** What the hand is: a second sentence. */
export function handSentence(source, holder, tool) {
  const words = HANDS[source] ?? "Another program is the hand.";
  return (words[holder] ?? words).replace("{}", tool);
}

/** What the band in the plot is, and what that means for the force. */
export function bandSentence(codec) {
  if (codec === "raw") return "Every force is sent, so there is no band, and no packet is saved.";
  const rest = codec === "deadband" ? "the finger feels the held one" : "both ends continue the force by the same rule";
  return `The band is what a finger cannot tell from the held force. While the true force is inside, nothing is sent, and ${rest}.`;
}

const CODECS = {
  raw: "Every force is sent.",
  deadband: "A force is sent only if a finger can tell it from the last one (the paper).",
  "motion-predictive": "Both ends compute the force from the hand’s own motion; only surprises are sent.",
  "adaptive-predictive": "Both ends continue the force as a learned curve; only surprises are sent.",
  "linear-predictive": "Both ends continue the force as a line; only surprises are sent.",
};

/** What a codec does, in plain words if it is one of hapticnet's own. */
export function codecWords(name, summary = "") {
  return CODECS[name] ?? summary;
}

/** What the threshold means at a force of one newton. */
export function thresholdWords(multiplier, weberFraction, floorN) {
  if (!(multiplier > 0)) return "Every change is sent";
  const atOne = 1000 * multiplier * Math.max(weberFraction, floorN);
  return `Changes within ${Number(atOne.toPrecision(3))}\u00a0mN of 1\u00a0N are not sent`;
}

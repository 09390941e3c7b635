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

export function hint(source, holder, { speed_m_per_s: speed, delay_ms: delay, axes = 1 }) {
  if (source !== "page") return "This page watches.";
  if (holder === "another") return "You watch until that page lets go.";
  const how = matchMedia("(pointer: coarse)").matches ? "Drag to push." : `${WAYS[axes - 1]} Esc lets go.`;
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

/** A scene that is no tissue in words, for screen readers. */
export function spaceWords(tipM, forceN) {
  const place = tipM.map((each) => signed(each * 1000, 0)).join(", ");
  return `Tool at ${place} millimetres${Number.isFinite(forceN) ? `, ${forceN.toFixed(1)} newtons` : ""}`;
}

/** The first sentence for somebody who sees the page: what there is, and what it does. */
export function firstSentence({ known, axes, tissues }, shapes) {
  if (known && axes === 1) {
    const layers = tissues.length === 1 ? "a layer" : `${tissues.length} layers`;
    return `A needle enters ${layers} of tissue at the slave, and each pushes back until it gives way.`;
  }
  return shapes ? `A tool moves at the slave among ${shapes}; what it touches pushes back, as the arrow shows.`
    : "A tool moves at the slave, in a scene that does not say how it looks: you see the tool, its path and the force on it.";
}

/** What the threshold means at a force of one newton. */
export function thresholdWords(multiplier, weberFraction, floorN) {
  if (!(multiplier > 0)) return "Every change is sent";
  const atOne = 1000 * multiplier * Math.max(weberFraction, floorN);
  return `Changes within ${Number(atOne.toPrecision(3))}\u00a0mN of 1\u00a0N are not sent`;
}

// Blocks of a recording: asks the server for those that are about to be shown, and keeps the newest.
//
// Pure but for `ask`: no sockets, no document. See hapticnet/web/replay.py for the messages.

import { decode } from "./wire.js";

const BLOCK = 4;
const HEAD = 32;
const KEPT = 60; // blocks, of a second each at 1 kHz: 1.5 MB
const MOST_ASKED = 3; // at once: the server leaves answers out if more than 256 kB wait for a page
const AGAIN_MS = 1500; // an answer that has not come by then was left out, and is asked for again

/** Return the message in an ArrayBuffer; null if it is of a kind this page does not know. */
export function readReplay(buffer) {
  const view = new DataView(buffer);
  if (buffer.byteLength < HEAD || view.getUint8(0) !== BLOCK) return decode(buffer);
  const [axes, tissues] = [view.getUint16(2, true), view.getUint16(14, true)];
  const [rows, columns] = [view.getUint32(8, true), view.getUint16(12, true)];
  const [frames, parts] = [view.getUint32(16, true), view.getUint32(20, true)];
  const numbers = columns * rows + (1 + axes + parts + tissues) * frames;
  if (view.byteLength < HEAD + 4 * numbers + tissues * frames) return null;
  let at = HEAD;
  const take = (count, length) => Array.from({ length: count }, () => {
    const column = new Float32Array(buffer, at, length);
    at += 4 * length;
    return column;
  });
  const block = {
    kind: "block",
    tape: view.getUint8(1),
    number: view.getUint32(4, true),
    beginS: view.getFloat64(24, true),
    rows,
    frames,
    columns: take(columns, rows),
    frameTimes: take(1, frames)[0],
    tip: take(axes, frames),
    push: take(parts, frames),
    surfaces: take(tissues, frames),
  };
  block.contacts = Array.from({ length: tissues }, (_, k) => new Uint8Array(buffer, at + k * frames, frames));
  return block;
}

export class Blocks {
  /**
   * @param {number} tape number of the recording
   * @param {object} about its description: `block_s` and `duration_s`
   * @param {function} ask called with a message to the server
   */
  constructor(tape, about, ask) {
    this._tape = tape;
    this._seconds = about.block_s;
    this._last = Math.floor(about.duration_s / about.block_s);
    this._ask = ask;
    this._kept = new Map(); // by number, in the order of use
    this._asked = new Map(); // when, by number
    this._missing = []; // of what is shown, the next to ask for first
    this.version = 0; // grows with each block that arrives
  }

  put(block) {
    this._asked.delete(block.number);
    this._missing = this._missing.filter((number) => number !== block.number);
    this._kept.set(block.number, block);
    if (this._kept.size > KEPT) this._kept.delete(this._kept.keys().next().value);
    this.version += 1;
    this._askNext(performance.now());
  }

  /** Forget what was asked for, because the connection was lost. */
  lost() {
    this._asked.clear();
  }

  /**
   * The blocks from one time [s] to another, as far as they are there, oldest first. Asks for the others, the one at
   * `atS` first, then those before it.
   */
  between(fromS, toS, atS, nowMs) {
    const found = [];
    const missing = [];
    const first = Math.max(0, Math.floor(fromS / this._seconds));
    for (let number = first; number <= Math.min(this._last, Math.floor(toS / this._seconds)); number += 1) {
      const block = this._kept.get(number);
      if (!block) missing.push(number);
      else {
        this._kept.delete(number);
        this._kept.set(number, block);
        found.push(block);
      }
    }
    const now = Math.floor(atS / this._seconds);
    const rank = (number) => (number <= now ? now - number : number - first);
    this._missing = missing.sort((a, b) => rank(a) - rank(b));
    this._askNext(nowMs);
    return found;
  }

  /** Whether the block of a time [s] is there; beyond the ends nothing is missing. */
  has(timeS) {
    const number = Math.floor(timeS / this._seconds);
    return number < 0 || number > this._last || this._kept.has(number);
  }

  _askNext(nowMs) {
    for (const [number, sinceMs] of this._asked) if (nowMs - sinceMs > AGAIN_MS) this._asked.delete(number);
    for (const number of this._missing) {
      if (this._asked.size >= MOST_ASKED) return;
      if (this._asked.has(number)) continue;
      this._asked.set(number, nowMs);
      this._ask("block", { tape: this._tape, number });
    }
  }
}

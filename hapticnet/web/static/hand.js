// The hand: turns drags and arrow keys into wanted positions of the needle, and sends them.
//
// A drag is relative: the needle moves by as much as the pointer does on the screen, wherever the drag begins, and stays
// when the pointer is lifted. The server limits the speed and smooths the motion; nothing here needs to.

import { encodeHand } from "./wire.js";

const SEND_EVERY_MS = 4.2; // below the server's limit of 250 a second
const KEY_SPEED_M_S = 0.03;
const KEY_STEP_M = 0.0005; // moved at once when a key goes down
const PAGE_STEP_M = 0.005;
const FINE = 0.2; // share of speed and step with Shift

export class Hand {
  /**
   * @param {HTMLElement} surface element to drag on
   * @param {object} link
   *   `send(type)` and `sendBinary(buffer)` of the connection; `tipM()` current tip; `metresPerPixel()`;
   *   `refused(text)` tells why the hand cannot be taken; `letGo()` is what Escape does
   */
  constructor(surface, link) {
    this._surface = surface;
    this._link = link;
    this._rangeM = [0, 0.1];
    this._repeatMs = 100;
    this._pointer = null;
    this._keys = new Set();
    this._fine = false;
    this._taking = false;
    this._sentMs = -Infinity;
    this._keysMs = 0;
    this.isOurs = false;
    this.obstacle = "the page is not connected yet"; // why the hand cannot be taken; null if it can
    this.wantedM = 0;
    this._listen();
    setInterval(() => this._repeat(), this._repeatMs / 2);
  }

  configure({ rangeM, repeatMs }) {
    if (rangeM) this._rangeM = rangeM;
    if (repeatMs) this._repeatMs = repeatMs;
  }

  /** Note who holds the hand, as the server says. */
  setHolder(holder) {
    const ours = holder === "you";
    if (ours && !this.isOurs) {
      this.isOurs = true;
      this._send(performance.now());
    } else if (!ours && this.isOurs) {
      this.isOurs = false;
      this._endDrag(); // a new press is needed to take it again
      this._keys.clear();
    }
    this._taking = false;
  }

  /** Take the hand where the needle is. */
  take() {
    if (this.isOurs || this._taking) return;
    if (this.obstacle) {
      this._link.refused(this.obstacle);
      return;
    }
    this._taking = true;
    this.wantedM = this._clamped(this._link.tipM());
    this._link.send("take");
  }

  giveBack() {
    if (this.isOurs || this._taking) this._link.send("release");
    this._endDrag();
    this._keys.clear();
  }

  /** The connection is lost: the server gives the hand away by itself. */
  lost() {
    this.isOurs = false;
    this._taking = false;
    this._endDrag();
    this._keys.clear();
  }

  /** Move by held keys; called once a frame. */
  advance(nowMs) {
    const direction = (this._keys.has("ArrowDown") ? 1 : 0) - (this._keys.has("ArrowUp") ? 1 : 0);
    const seconds = Math.min(0.1, (nowMs - this._keysMs) / 1000);
    this._keysMs = nowMs;
    if (direction) this._move(direction * KEY_SPEED_M_S * (this._fine ? FINE : 1) * seconds, nowMs);
  }

  _listen() {
    const surface = this._surface;
    surface.addEventListener("pointerdown", (event) => this._press(event));
    surface.addEventListener("pointermove", (event) => this._drag(event));
    for (const type of ["pointerup", "pointercancel", "lostpointercapture"]) {
      surface.addEventListener(type, (event) => event.pointerId === this._pointer?.id && this._endDrag());
    }
    document.addEventListener("keydown", (event) => this._keyDown(event));
    document.addEventListener("keyup", (event) => {
      this._fine = event.shiftKey;
      this._keys.delete(event.key);
    });
    addEventListener("blur", () => this._keys.clear());
    document.addEventListener("visibilitychange", () => document.hidden && this.giveBack());
    addEventListener("pagehide", () => this.giveBack());
  }

  _press(event) {
    if (event.button !== 0 || this._pointer) return;
    this.take();
    if (!this.isOurs && !this._taking) return;
    this._surface.setPointerCapture(event.pointerId);
    this._pointer = { id: event.pointerId, y: event.clientY };
    this._surface.dataset.dragging = "";
  }

  _drag(event) {
    if (event.pointerId !== this._pointer?.id) return;
    // A mouse may report several positions between two frames; each is sent with its own time.
    const motions = event.getCoalescedEvents?.() ?? [];
    for (const motion of motions.length ? motions : [event]) {
      const movedM = (motion.clientY - this._pointer.y) * this._link.metresPerPixel();
      this._pointer.y = motion.clientY;
      this._move(movedM, motion.timeStamp);
    }
  }

  _endDrag() {
    this._pointer = null;
    delete this._surface.dataset.dragging;
  }

  _keyDown(event) {
    if (event.altKey || event.ctrlKey || event.metaKey) return;
    if (event.key === "Escape") {
      this._link.letGo();
      return;
    }
    if (document.activeElement.closest("input, select, dialog, [popover]")) return; // they use the same keys
    const moves = { ArrowDown: KEY_STEP_M, ArrowUp: -KEY_STEP_M, PageDown: PAGE_STEP_M, PageUp: -PAGE_STEP_M, Home: -1 };
    if (!(event.key in moves)) return;
    event.preventDefault();
    this._fine = event.shiftKey;
    if (event.repeat && event.key.startsWith("Arrow")) return; // `advance` moves while the key is down
    this.take();
    if (!this.isOurs && !this._taking) return;
    if (event.key.startsWith("Arrow")) {
      this._keys.add(event.key);
      this._keysMs = performance.now();
    }
    this._move(moves[event.key] * (this._fine ? FINE : 1), event.timeStamp);
  }

  _move(byM, timeMs) {
    this.wantedM = this._clamped(this.wantedM + byM);
    if (this.isOurs && timeMs - this._sentMs >= SEND_EVERY_MS) this._send(timeMs);
  }

  // Also sends the last of a burst of motions, which the limit may have held back.
  _repeat() {
    if (!this.isOurs) return;
    const nowMs = performance.now();
    if (nowMs - this._sentMs >= this._repeatMs * 0.8 || this.wantedM !== this._sentM) this._send(nowMs);
  }

  _send(timeMs) {
    this._sentMs = timeMs;
    this._sentM = this.wantedM;
    this._link.sendBinary(encodeHand(this.wantedM, timeMs));
  }

  _clamped(positionM) {
    return Math.min(this._rangeM[1], Math.max(this._rangeM[0], positionM));
  }
}

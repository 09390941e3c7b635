// The hand: turns drags and arrow keys into wanted positions of the needle, and sends them.
//
// A drag is relative: the needle moves by as much as the pointer does on the screen, wherever the drag begins, and stays
// when the pointer is lifted. The server limits the speed and smooths the motion; nothing here needs to. A wheel, W and S,
// two fingers that move up and down, and the right stick of a game controller move away and back.

import { encodeHand } from "./wire.js";

const SEND_EVERY_MS = 4.2; // below the server's limit of 250 a second
const KEY_SPEED_M_S = 0.03;
const KEY_STEP_M = 0.0005; // moved at once when a key goes down
const PAGE_STEP_M = 0.005;
const FINE = 0.2; // share of speed and step with Shift
const WHEEL_M_PER_PX = 5e-5;
const STICK_SPEED_M_S = 0.05;
const STICK_REST = 0.15; // a stick at rest is not quite in the middle
// Directions [right, down, away] of the keys that move while they are down.
const MOVES = { ArrowRight: [1, 0, 0], ArrowLeft: [-1, 0, 0], ArrowDown: [0, 1, 0], ArrowUp: [0, -1, 0], w: [0, 0, 1], s: [0, 0, -1] };
const STEPS_M = { PageDown: PAGE_STEP_M, PageUp: -PAGE_STEP_M, Home: -1 };

export class Hand {
  /**
   * @param {HTMLElement} surface element to drag on
   * @param {object} link
   *   `send(type)` and `sendBinary(buffer)` of the connection; `tipM()` current tip on each axis; `metresPerPixel()`;
   *   `toAxes([right, down, away])` the same motion along the axes;
   *   `refused(text)` tells why the hand cannot be taken; `letGo()` is what Escape does
   */
  constructor(surface, link) {
    this._surface = surface;
    this._link = link;
    this._rangesM = [[0, 0.1]];
    this._repeatMs = 100;
    this._pointer = null;
    this._second = null; // a second finger, while it is down
    this._keys = new Set();
    this._buttons = [];
    this._fine = false;
    this._taking = false;
    this._sentMs = -Infinity;
    this._keysMs = 0;
    this.isOurs = false;
    this.obstacle = "the page is not connected yet"; // why the hand cannot be taken; null if it can
    this.wantedM = [0];
    this._listen();
    setInterval(() => this._repeat(), this._repeatMs / 2);
  }

  configure({ rangesM, repeatMs }) {
    if (rangesM) this._rangesM = rangesM;
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
    const seconds = Math.min(0.1, (nowMs - this._keysMs) / 1000);
    this._keysMs = nowMs;
    const distance = KEY_SPEED_M_S * (this._fine ? FINE : 1) * seconds;
    for (const key of this._keys) this._move(times(MOVES[key], distance), nowMs);
    this._followSticks(seconds, nowMs);
  }

  /** Take the hand with the first button of a game controller, let go with the second, and move with the sticks. */
  _followSticks(seconds, nowMs) {
    const pad = [...(navigator.getGamepads?.() ?? [])].find((each) => each?.connected);
    const pressed = pad?.buttons.slice(0, 2).map((each) => each.pressed) ?? [];
    if (pressed[0] && !this._buttons[0]) this.take();
    if (pressed[1] && !this._buttons[1]) this._link.letGo();
    this._buttons = pressed;
    if (!pad || !this.isOurs) return;
    const [right = 0, down = 0, , back = 0] = pad.axes;
    const push = [right, down, -back].map((each) => (Math.abs(each) > STICK_REST ? each : 0));
    if (push.some(Boolean)) this._move(times(push, STICK_SPEED_M_S * seconds), nowMs);
  }

  _listen() {
    const surface = this._surface;
    surface.addEventListener("pointerdown", (event) => this._press(event));
    surface.addEventListener("pointermove", (event) => this._drag(event));
    for (const type of ["pointerup", "pointercancel", "lostpointercapture"]) {
      surface.addEventListener(type, (event) => this._lift(event));
    }
    surface.addEventListener("wheel", (event) => this._turn(event), { passive: false });
    document.addEventListener("keydown", (event) => this._keyDown(event));
    document.addEventListener("keyup", (event) => {
      this._fine = event.shiftKey;
      this._keys.delete(named(event));
    });
    addEventListener("blur", () => this._keys.clear());
    document.addEventListener("visibilitychange", () => document.hidden && this.giveBack());
    addEventListener("pagehide", () => this.giveBack());
  }

  _press(event) {
    if (event.button !== 0) return;
    if (this._pointer) {
      this._second ??= { id: event.pointerId, y: event.clientY };
      return;
    }
    this.take();
    if (!this.isOurs && !this._taking) return;
    this._surface.setPointerCapture(event.pointerId);
    this._pointer = { id: event.pointerId, x: event.clientX, y: event.clientY };
    this._surface.dataset.dragging = "";
  }

  _lift({ pointerId: id }) {
    if (id === this._second?.id) this._second = null;
    else if (id === this._pointer?.id) this._endDrag();
  }

  _drag(event) {
    if (event.pointerId === this._second?.id) {
      this._move([0, 0, (this._second.y - event.clientY) * this._link.metresPerPixel()], event.timeStamp);
      this._second.y = event.clientY;
      return;
    }
    if (event.pointerId !== this._pointer?.id) return;
    // A mouse may report several positions between two frames; each is sent with its own time.
    const motions = event.getCoalescedEvents?.() ?? [];
    for (const motion of motions.length ? motions : [event]) {
      const { clientX: x, clientY: y } = motion;
      const by = times([x - this._pointer.x, y - this._pointer.y, 0], this._link.metresPerPixel());
      if (!this._second) this._move(by, motion.timeStamp);
      Object.assign(this._pointer, { x, y });
    }
  }

  _turn(event) {
    if (!this.isOurs) return;
    event.preventDefault();
    this._move([0, 0, -event.deltaY * WHEEL_M_PER_PX], event.timeStamp);
  }

  _endDrag() {
    this._pointer = this._second = null;
    delete this._surface.dataset.dragging;
  }

  _keyDown(event) {
    if (event.altKey || event.ctrlKey || event.metaKey) return;
    if (event.key === "Escape") {
      if (!document.querySelector(":popover-open")) this._link.letGo(); // otherwise it closes that
      return;
    }
    if (document.activeElement.closest("input, select, dialog, [popover]")) return; // they use the same keys
    const key = named(event);
    const moves = key in MOVES && this._link.toAxes(MOVES[key]).some(Boolean);
    if (!moves && !(key in STEPS_M)) return;
    if (!this.isOurs && document.activeElement === document.body && scrolls()) return; // they scroll a long page
    event.preventDefault();
    this._fine = event.shiftKey;
    if (event.repeat && moves) return; // `advance` moves while the key is down
    this.take();
    if (!this.isOurs && !this._taking) return;
    const share = this._fine ? FINE : 1;
    if (moves) {
      this._keys.add(key);
      this._keysMs = performance.now();
      this._move(times(MOVES[key], KEY_STEP_M * share), event.timeStamp);
    } else {
      this._moveAxes([STEPS_M[key] * share], event.timeStamp);
    }
  }

  /** Move [right, down, away] by metres. */
  _move(motion, timeMs) {
    this._moveAxes(this._link.toAxes(motion), timeMs);
  }

  _moveAxes(byM, timeMs) {
    this.wantedM = this._clamped(this.wantedM.map((each, axis) => each + (byM[axis] ?? 0)));
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
    return positionM.map((each, axis) => Math.min(this._rangesM[axis][1], Math.max(this._rangesM[axis][0], each)));
  }
}

function times(motion, by) {
  return motion.map((each) => each * by);
}

function scrolls() {
  const { scrollHeight, clientHeight } = document.documentElement;
  return scrollHeight > clientHeight + 1;
}

/** A key; letters without Shift. */
function named({ key }) {
  return key.length === 1 ? key.toLowerCase() : key;
}

// What both views have: connection, scene, hand, notices, theme and texts for screen readers. A page of another package
// extends it, and may say all of it in other words (`_handWords` and what follows it).

import { Connection } from "./connection.js";
import { Hand } from "./hand.js";
import { SceneView } from "./scene.js";
import { SpaceView } from "./space.js";
import { texts } from "./texts.js";
import { handWords, hint, sceneWords, spaceWords } from "./words.js";

const ERROR_MS = 6000;
const WORDS_EVERY_MS = 1000;

const byId = (id) => document.getElementById(id);

export class Stage {
  /**
   * @param {string} view "watch" or "operator"
   * @param {object} on handlers by kind of message, called after the stage's own; also `draw(nowMs)` for each frame,
   *   `forceN()` for the arrow, and `lost()`
   */
  constructor(view, on = {}) {
    this._on = on;
    this._handInfo = { source: "page", speed_m_per_s: 0.06, delay_ms: 50, repeat_ms: 100 };
    this._holder = "nobody";
    this._handState = "free";
    this._scene = null;
    this._ready = null;
    this._closed = null;
    this._error = null;
    this._contacts = [];
    this._wordsMs = 0;
    this._limit = null;
    this._swings = false;
    this._pushN = [];
    this.canvas = byId("scene");
    this.scene = new SceneView(this.canvas, { onBreach: (index) => this._breached(index) });
    this.space = new SpaceView(this.canvas);
    this.connection = new Connection(view, {
      open: () => this._opened(),
      closed: (how) => this._lost(how),
      message: (message) => this._receive(message),
    });
    this.hand = new Hand(this.canvas, {
      send: (type) => this.connection.send(type),
      sendBinary: (buffer) => this.connection.sendBinary(buffer),
      tipM: () => (this.isSpace ? this.space.tip.slice(0, this._scene.axes) : [this.scene.tipM]),
      metresPerPixel: () => this._view.metresPerPixel(),
      toAxes: (motion) => this._view.toAxes(motion),
      refused: (why) => this.complain(why),
      letGo: () => this.letGo(),
    });
    this._mayStopOthers = view === "watch";
    byId("hand-button").addEventListener("click", () => this._pressButton());
    byId("notice").querySelector("button").addEventListener("click", () => this._retry());
    for (const type of ["gamepadconnected", "gamepaddisconnected"]) addEventListener(type, () => this._show());
    this._show();
    requestAnimationFrame((nowMs) => this._frame(nowMs));
  }

  /** Whether the scene is none of layers of tissue. */
  get isSpace() {
    return this._scene !== null && (this._scene.axes > 1 || !this._scene.known);
  }

  /** Where the positions come from, in a word. */
  get source() {
    return this._handInfo.source;
  }

  /** Who has the hand: you, another or nobody. */
  get holder() {
    return this._holder;
  }

  get _view() {
    return this.isSpace ? this.space : this.scene;
  }

  /** Give the own hand back: the needle is withdrawn. */
  letGo() {
    this.hand.giveBack();
  }

  /** Tell a person for a few seconds what went wrong. */
  complain(text) {
    this._tell(["warn", texts.not_possible, sentence(text)]);
  }

  /** Tell a person for a few seconds what something is. */
  tell(text) {
    this._tell(["info", text, ""]);
  }

  _tell(notice) {
    this._error = notice;
    clearTimeout(this._errorTimer);
    this._errorTimer = setTimeout(() => {
      this._error = null;
      this._show();
    }, ERROR_MS);
    this._show();
  }

  /** Tell that the device renders less than the held force, if `limitN` is given. */
  setLimit(limitN) {
    if (limitN === this._limit) return;
    this._limit = limitN;
    this._show();
  }

  /** Tell whether force and hand swing against each other. */
  setSwings(swings) {
    if (swings === this._swings) return;
    this._swings = swings;
    this._show();
  }

  announce(text) {
    byId("announcer").textContent = text;
  }

  /** Show the state of the connection in the header. */
  setLink(level, text) {
    const pill = byId("link-state");
    pill.dataset.level = level;
    pill.querySelector("b").textContent = text;
  }

  _receive(message) {
    const own = this[`_on_${message.kind}`];
    own?.call(this, message);
    this._on[message.kind]?.(message);
  }

  _on_hello(message) {
    this._handInfo = message.hand;
    this.hand.configure({ repeatMs: message.hand.repeat_ms });
    this.space.clear();
  }

  _on_shapes(message) {
    this.space.setShapes(message);
  }

  _on_scene(message) {
    this._scene = message;
    this._contacts = [];
    this.scene.setScene(message);
    this.space.setScene(message);
    const aside = [-message.reach_m, message.reach_m];
    this.hand.configure({ rangesM: [message.range_m, aside, aside] });
    this._label ??= this.canvas.ariaLabel;
    this.canvas.ariaLabel = this.isSpace ? "Tool" : this._label;
    this.canvas.ariaValueMin = (message.range_m[0] * 1000).toFixed(0);
    this.canvas.ariaValueMax = (message.range_m[1] * 1000).toFixed(0);
    this._show();
  }

  _on_frame(frame) {
    this._contacts = frame.contacts;
    const axes = this._scene?.axes ?? 1;
    this._pushN = frame.further.slice(axes - 1);
    this.scene.setFrame(frame);
    this.space.setFrame({ tipM: frame.tipM, furtherM: frame.further.slice(0, axes - 1) });
    if (frame.handState !== this._handState) {
      this._handState = frame.handState;
      this._show();
    }
  }

  _on_hand({ holder, state }) {
    const had = this._holder;
    this._holder = holder;
    this._handState = state;
    this._error = null;
    this.hand.setHolder(holder);
    this._show();
    if (holder !== had) this.announce(byId("hand-state").textContent);
  }

  _on_ready({ ready }) {
    if (this._ready !== null && ready !== this._ready) this._announceReady(ready);
    this._ready = ready;
    this._show();
  }

  _on_error({ message }) {
    this.complain(message);
  }

  _opened() {
    this._closed = null;
    this._show();
  }

  _lost(how) {
    this._closed = how;
    this._ready = null;
    this._holder = "nobody";
    this.hand.lost();
    this.setLink(how.final ? "bad" : "wait", how.final ? texts.closed : texts.reconnecting);
    this._on.lost?.();
    this._show();
  }

  _retry() {
    this.setLink("wait", texts.connecting);
    this._closed = { again: true };
    this._show();
    this.connection.retry();
  }

  _pressButton() {
    const { action } = byId("hand-button").dataset;
    if (action === "let-go") {
      this.letGo();
    } else if (action === "withdraw") {
      this.connection.send("let_go");
    } else {
      this.hand.take();
      this.canvas.focus({ preventScroll: true }); // so that the arrow keys move the needle
    }
  }

  _breached(index) {
    this.announce(this._breachWords(index));
  }

  _handWords() {
    return handWords(this._handInfo.source, this._holder, this._handState);
  }

  _hint() {
    return hint(this._handInfo.source, this._holder, { ...this._handInfo, axes: this._scene?.axes });
  }

  _sceneWords(forceN) {
    if (this.isSpace) return spaceWords(this.space.tip.slice(0, this._scene.axes), forceN);
    return sceneWords(this.scene.tipM, this._scene?.tissues ?? [], this._contacts, forceN);
  }

  _announceReady(ready) {
    this.announce(ready ? "The scene can be touched" : "The slave does not answer");
  }

  _breachWords(index) {
    return `${this._scene.tissues[index].name ?? `Tissue ${index + 1}`} breached`;
  }

  /** Redraw all texts about connection and hand. */
  _show() {
    const { source } = this._handInfo;
    const online = this.connection?.isOpen ?? false;
    document.body.toggleAttribute("data-offline", !online);
    if (this.hand) this.hand.obstacle = this._obstacle(online, source);
    const named = (words) => (this.isSpace ? words.replace("needle", "tool") : words);
    byId("hand-state").textContent = online ? named(this._handWords()) : this._closed?.final ? texts.closed : texts.connecting;
    byId("hint").textContent = online ? this._hint() : "";
    const withdraws = this._mayStopOthers && this._holder === "another";
    const letsGo = this._holder === "you";
    const button = byId("hand-button");
    button.textContent = letsGo ? texts.let_go : withdraws ? texts.withdraw : named(texts.take);
    button.dataset.action = letsGo ? "let-go" : withdraws ? "withdraw" : "take";
    button.disabled = !letsGo && !withdraws && (!online || this._holder !== "nobody");
    button.hidden = source !== "page";
    this.canvas.ariaDisabled = String(source !== "page" || !online);
    this._notify(online);
  }

  _obstacle(online, source) {
    if (!online) return texts.lost;
    if (source !== "page") return `${handWords(source)}. To move it here, start the master with --operator page.`;
    return this._holder === "another" ? "Another page moves the needle." : null;
  }

  _notify(online) {
    const [level, title, detail, again] = this._notice(online) ?? [];
    const notice = byId("notice");
    notice.hidden = !title;
    if (!title) return;
    notice.dataset.level = level;
    const [titleBox, detailBox] = notice.querySelectorAll("b, span");
    // Unchanged text must not be written again: a screen reader would repeat it.
    if (titleBox.textContent !== title) titleBox.textContent = title;
    if (detailBox.textContent !== detail) detailBox.textContent = detail;
    notice.querySelector("button").hidden = !again;
  }

  /** The most important thing to tell: level, title, detail, and whether there is a button to try again. */
  _notice(online) {
    if (this._closed?.final) {
      return ["bad", texts.refused, sentence(this._closed.reason || "It gave no reason"), true];
    }
    if (this._closed && !this._closed.again) {
      return ["warn", texts.lost, texts.lost_text];
    }
    if (!online) return ["wait", texts.connecting, ""];
    if (this._error) return this._error;
    if (this._ready === false) {
      return ["warn", "The slave does not answer", "Force fades to zero. The needle moves, but it touches nothing."];
    }
    if (this._swings) return ["bad", "The hand swings", "The force comes late and pushes the hand on. A coupling that bounds the energy, or less delay, brings it to rest."];
    if (this._limit) return ["info", `The device presses with ${this._limit} N at most`, "The force is larger: a finger would feel less of it."];
    if (this._holder === "you" && this._handState === "holding") {
      return ["info", "The needle is held", "This page was silent for a moment. Move to continue."];
    }
    return null;
  }

  _frame(nowMs) {
    this.hand.advance(nowMs);
    this._on.draw?.(nowMs);
    const forceN = this._on.forceN?.() ?? null;
    const invites = this._ready && this._holder === "nobody" && this._handState === "free" && this.hand.obstacle === null;
    const wantedM = this.hand.isOurs ? this.hand.wantedM : null;
    if (!this.isSpace) this.scene.draw(nowMs, { wantedM, forceN, invites });
    else this.space.draw(nowMs, { wantedM, forceN: this._scene.axes > 1 ? this._pushN : forceN === null ? null : [forceN] });
    if (nowMs - this._wordsMs > WORDS_EVERY_MS) {
      this._wordsMs = nowMs;
      this.canvas.ariaValueNow = (this.scene.tipM * 1000).toFixed(1);
      this.canvas.ariaValueText = this._sceneWords(forceN);
    }
    requestAnimationFrame((next) => this._frame(next));
  }
}

function sentence(text) {
  const whole = text.charAt(0).toUpperCase() + text.slice(1);
  return /[.!?]$/.test(whole) ? whole : `${whole}.`;
}

// The screens of an experiment: instructions, questions and answers. The server decides what comes next; this shows it.

import { filled } from "./study_texts.js";
import { texts } from "./texts.js";

const TISSUES = ["1", "2", "3"];
const PLACES = ["front", "middle", "back"];
const PERFORMED = ["meet", "trial", "stimuli"]; // screens during which Escape stops what is felt
const MAIN_KEYS = ["enter", "y"];
const ANSWER_KEYS = [...TISSUES, "backspace", "enter"];

/** The key of the task that an event means; "" if it is none. */
export function keyOf({ code, key }) {
  const digit = /^(?:Digit|Numpad)([0-9])$/.exec(code); // by its place: some layouts need Shift for digits
  if (digit) return digit[1];
  return key === "Enter" || key === "Escape" || key === "Backspace" || key.length === 1 ? key.toLowerCase() : "";
}

/** What a key does as a label and a remark: "stop: the force goes to zero" has both. */
export function labelOf(does) {
  const [label, remark = ""] = does.split(": ");
  return [label.charAt(0).toUpperCase() + label.slice(1), remark];
}

export class TaskView {
  /**
   * @param {object} on `press(number, key)`, `announce(text)`, and `touch()` to put the focus on the scene
   */
  constructor(on) {
    this._on = on;
    this._task = null;
    this._box = document.getElementById("task");
    this._ending = document.getElementById("ending");
    this._goOnMs = 0;
    this._box.addEventListener("click", (event) => {
      const key = event.target.closest("button")?.dataset.key;
      if (key) this._press(key);
    });
    document.addEventListener("keydown", (event) => this._keyDown(event));
    this._ending.addEventListener("click", ({ target }) => {
      if (target.value) this._ending.close();
      if (target.value === "end") this._send("escape");
    });
    setInterval(() => this._count(), 250);
  }

  show(task) {
    const before = this._task;
    const isNew = before?.number !== task.number;
    this._task = task;
    this._does = new Map(task.keys.map(({ key, does }) => [key, does]));
    this._goOnMs = performance.now() + 1000 * task.wait_s;
    document.body.dataset.screen = task.screen;
    const focused = this._box.contains(document.activeElement) ? document.activeElement.dataset.key : null;
    this._box.hidden = task.screen === "wait";
    this._box.replaceChildren(...this._content());
    this._count();
    if (isNew) this._enter();
    else this._stay(before, focused);
  }

  /** Put the focus where the participant needs it now; a screen reader then reads the new screen. */
  _enter() {
    this._ending.close();
    if (this._task.screen === "trial") this._on.touch();
    else this._box.querySelector("h2")?.focus();
    scrollTo(0, 0);
  }

  _stay(before, focused) {
    const same = focused && this._box.querySelector(`button[data-key="${focused}"]:not(:disabled)`);
    if (same) same.focus();
    else if (focused) this._box.querySelector("button:not(:disabled)")?.focus();
    if (this._task.remark && before.remark !== this._task.remark) this._on.announce(this._task.remark);
    if (before.typed !== this._task.typed) {
      this._on.announce(filled(texts.answer, { answer: [...this._task.typed].join(", ") || "–" }));
    }
  }

  _content() {
    const { screen, title, text, progress, remark } = this._task;
    const heading = make("h2", { tabIndex: -1, "aria-describedby": "task-text" }, title);
    const parts = [heading, make("p", { className: remark ? "text remark" : "text", id: "task-text" }, remark || text)];
    if (progress) parts.unshift(make("p", { className: "quiet progress" }, progress));
    if (screen === "trial") parts.push(this._slots(), this._tissues(), this._choices(["backspace", "enter"]));
    else if (screen === "rating") parts.push(this._scale());
    else parts.push(this._choices([...this._does.keys()].filter((key) => key !== "escape")));
    if (this._does.has("escape")) parts.push(this._leave());
    return parts;
  }

  /** The answer so far, from the softest to the hardest. */
  _slots() {
    const items = TISSUES.map((_, place) => {
      const typed = this._task.typed[place];
      return make("li", { className: typed ? "full" : "empty" }, typed ?? "–");
    });
    const row = make("ol", { className: "slots", ariaLabel: filled(texts.answer, { answer: "" }) }, ...items);
    return make("div", { className: "answer" }, make("span", {}, texts.softest), row, make("span", {}, texts.hardest));
  }

  _tissues() {
    const buttons = TISSUES.map((key, index) => {
      const button = this._button(key, labelOf(filled(texts.tissue, { number: key }))[0], texts[PLACES[index]], "tissue");
      button.disabled = !this._does.has(key);
      return button;
    });
    return make("div", { className: "choices tissues" }, ...buttons);
  }

  _scale() {
    const keys = [...this._does.keys()].filter((key) => key !== "escape");
    const buttons = keys.map((key) => make("button", { type: "button", className: "secondary", "data-key": key }, key));
    const ends = [texts.rating_low, texts.rating_high].map((words) => make("span", {}, words));
    return make(
      "div",
      { className: "scale" },
      make("div", { className: "choices", role: "group", ariaLabel: texts.rating }, ...buttons),
      make("p", { className: "quiet ends" }, ...ends),
    );
  }

  _choices(keys) {
    const buttons = keys.map((key) => {
      const does = this._does.get(key) ?? { enter: texts.confirm, backspace: texts.undo }[key];
      const [label, remark] = labelOf(does);
      const button = this._button(key, label, remark, MAIN_KEYS.includes(key) ? "primary" : "secondary");
      button.disabled = !this._does.has(key);
      return button;
    });
    return make("div", { className: `choices of-${buttons.length}` }, ...buttons);
  }

  _leave() {
    const [label, remark] = labelOf(this._does.get("escape"));
    return make("div", { className: "leave" }, this._button("escape", label, remark, remark ? "stop" : "plain"));
  }

  _button(key, label, remark, className) {
    const words = [make("b", {}, label)];
    if (remark) words.push(make("small", {}, remark));
    const parts = [make("span", {}, ...words), make("kbd", {}, texts[key] ?? key.toUpperCase())];
    return make("button", { type: "button", className, "data-key": key }, ...parts);
  }

  /** Count down until the participant may go on. */
  _count() {
    const button = this._box.querySelector('button[data-key="enter"]');
    if (!button || !this._task.wait_s) return;
    const seconds = Math.ceil((this._goOnMs - performance.now()) / 1000);
    button.disabled = seconds > 0;
    button.querySelector("b").textContent = seconds > 0 ? filled(texts.go_on_in, { seconds }) : labelOf(this._does.get("enter"))[0];
  }

  _keyDown(event) {
    if (!this._task || this._ending.open || event.repeat || event.ctrlKey || event.altKey || event.metaKey) return;
    const key = keyOf(event);
    const focused = document.activeElement;
    if (focused instanceof HTMLButtonElement && (key === "enter" || key === " ")) return; // that presses the button
    if (!this._takes(key)) return;
    event.preventDefault();
    this._press(key);
  }

  /** Whether a key does something. A fast typist is ahead of the server's answers, which decide in a trial. */
  _takes(key) {
    return this._does.has(key) || (this._task.screen === "trial" && ANSWER_KEYS.includes(key));
  }

  _press(key) {
    if (!this._takes(key) || (key === "enter" && performance.now() < this._goOnMs)) return;
    const endsSession = key === "escape" && !PERFORMED.includes(this._task.screen);
    if (endsSession) this._ending.showModal();
    else this._send(key);
  }

  _send(key) {
    this._on.press(this._task.number, key);
  }
}

function make(tag, properties, ...children) {
  const element = document.createElement(tag);
  for (const [name, value] of Object.entries(properties)) {
    if (name in element) element[name] = value;
    else element.setAttribute(name, value);
  }
  element.append(...children);
  return element;
}

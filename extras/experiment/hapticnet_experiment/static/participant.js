// The participant's page: the operator view, what to do, and the answers. The server sends it nothing that would reveal
// the condition of a trial.

import { MaskingNoise } from "./noise.js";
import { Stage } from "./stage.js";
import { filled, useTexts } from "./study_texts.js";
import { TaskView } from "./task.js";
import { texts } from "./texts.js";

const GONE_MS = 15_000; // a session that was interrupted does not come back by itself so soon

/** The stage in the words of the study. */
class ParticipantStage extends Stage {
  isOver = false; // nothing more will come, and the server may close the page

  _on_hello(message) {
    useTexts(message.experiment.texts);
    this.scene.isPlain = true;
    super._on_hello(message);
  }

  _opened() {
    this._lostMs = null;
    super._opened();
  }

  _lost(how) {
    this._lostMs ??= performance.now();
    setTimeout(() => this._show(), GONE_MS);
    super._lost(how);
  }

  _handWords() {
    return this._handInfo.source === "page" ? super._handWords() : texts.elsewhere;
  }

  _hint() {
    return this._handInfo.source === "page" ? texts.hint : texts.hint_elsewhere;
  }

  _sceneWords() {
    if (!this._scene) return ""; // the texts come with the hello, and so does the scene
    return filled(texts.depth, { depth: (this.scene.tipM * 1000).toFixed(0) });
  }

  _announceReady() {} // what comes next is told by the task

  _breachWords(index) {
    return filled(texts.breached, { number: index + 1 });
  }

  _obstacle(online, source) {
    if (!online) return texts.lost;
    return this._ready && source === "page" ? null : texts.not_yet;
  }

  _notice(online) {
    if (this._closed && this.isOver) return null;
    if (online && !this._error && !this._ready) return null; // what comes next is told by the task
    const notice = super._notice(online);
    const isGone = notice?.[1] === texts.lost && performance.now() - this._lostMs >= GONE_MS;
    return isGone ? ["warn", texts.lost, texts.gone_text] : notice;
  }
}

const stage = new ParticipantStage("operator", {
  hello: ({ experiment }) => begin(experiment),
  ready: () => stage.setLink("good", texts.connected),
  task: (message) => {
    stage.isOver = ["done", "stopped"].includes(message.screen); // then the screen says what there is to say
    task.show(message);
    if (stage.isOver) noise.stop();
  },
  lost: () => stage.isOver && stage.setLink("good", texts.finished),
});

const task = new TaskView({
  press: (number, key) => stage.connection.send("key", { number, key }),
  announce: (text) => stage.announce(text),
  touch: () => stage.canvas.focus({ preventScroll: true }),
});

let noise = null;

function begin({ masking_noise: isExpected }) {
  if (noise) return; // the page has connected again
  noise = new MaskingNoise({ changed: (level) => stage.connection.send("noise", { level }) });
  if (isExpected) noise.startWithFirstPress();
}

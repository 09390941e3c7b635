// The operator view: scene and hand only. The server sends it nothing that would reveal the condition of a trial. In an
// experiment it also shows what to do, and takes the answers.

import { MaskingNoise } from "./noise.js";
import { Stage } from "./stage.js";
import { TaskView } from "./task.js";
import { texts } from "./texts.js";

let inExperiment = false;
let noise = null;

const stage = new Stage("operator", {
  hello: ({ experiment }) => experiment && begin(experiment),
  ready: ({ ready }) => {
    if (inExperiment) stage.setLink("good", texts.connected);
    else stage.setLink(ready ? "good" : "warn", ready ? "Ready" : "Not ready");
  },
  task: (message) => {
    stage.isOver = ["done", "stopped"].includes(message.screen); // then the screen says what there is to say
    task.show(message);
    if (stage.isOver) noise?.stop();
  },
  lost: () => stage.isOver && stage.setLink("good", texts.finished),
});

const task = new TaskView({
  press: (number, key) => stage.connection.send("key", { number, key }),
  announce: (text) => stage.announce(text),
  touch: () => stage.canvas.focus({ preventScroll: true }),
});

function begin({ masking_noise: isExpected }) {
  if (inExperiment) return; // the page has connected again
  inExperiment = true;
  document.body.classList.add("experiment");
  document.querySelector("main").append(document.getElementById("notice")); // it is seen without the scene, too
  noise = new MaskingNoise({ changed: (level) => stage.connection.send("noise", { level }) });
  if (isExpected) noise.startWithFirstPress();
}

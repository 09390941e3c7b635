// The page of a replay: one or two recordings on one time axis, played here for this page alone.

import { readReplay } from "./blocks.js";
import { Connection } from "./connection.js";
import { difference } from "./difference.js";
import { Player } from "./player.js";
import { TapeView } from "./tape.js";

const FIGURES_EVERY_MS = 150;
const STEPS_N = [0.5, 1, 2, 3, 4, 6, 8, 10, 15, 20, 30, 50, 100, 200, 500, 1000];

const byId = (id) => document.getElementById(id);

let views = [];
let greeting = "";
let askedMs = -Infinity;
let askedS = null; // time of the newest figures asked for

const player = new Player({
  seek: () => views.forEach((view) => view.jump()),
  say: (text) => {
    byId("announcer").textContent = text;
  },
});

const connection = new Connection("watch", {
  open: () => setLink("good", "Connected"),
  closed: ({ final, reason }) => {
    setLink(final ? "bad" : "wait", final ? sentence(reason || "closed") : "Connecting again");
    askedS = null;
    for (const view of views) view.blocks.lost();
  },
  message: (message) => handlers[message.kind]?.(message),
}, readReplay);

const handlers = {
  hello: begin,
  block: (block) => views[block.tape]?.blocks.put(block),
  figures: ({ t_s: timeS, tapes }) => {
    if (timeS === askedS) views.forEach((view, index) => view.showFigures(tapes[index]));
  },
};

function begin(hello) {
  const words = JSON.stringify(hello);
  if (words !== greeting) {
    greeting = words;
    const { tapes } = hello;
    const highest = Math.max(0.4, ...tapes.map(({ top_n: top }) => top));
    const topN = STEPS_N.find((each) => each >= highest * 1.06) ?? highest * 1.2;
    const lowest = Math.min(...tapes.map(({ bottom_n: bottom }) => bottom));
    const bottomN = lowest < -0.15 ? -(STEPS_N.find((each) => each >= -lowest * 1.06) ?? -lowest * 1.2) : -topN * 0.035;
    const box = byId("tapes");
    box.replaceChildren();
    document.body.dataset.count = tapes.length;
    const ask = (type, content) => connection.send(type, content);
    const options = { historyS: hello.history_s, bottomN, topN, ask, onEnlarge: () => player.pause() };
    views = tapes.map((about, number) => new TapeView(box, number, about, options));
    document.title = `${tapes.map(({ name }) => name).join(", ")} – hapticnet replay`;
    const when = tapes.length < 2 ? "" : hello.together ? " Recorded at the same time: shown at the same moments." : " Each is shown from its beginning.";
    const said = difference(tapes);
    byId("difference").textContent = said + when;
    byId("difference").hidden = !said;
  }
  player.configure(hello);
}

function draw(nowMs) {
  requestAnimationFrame(draw);
  if (!views.length) return;
  const wasPlaying = player.isPlaying;
  const isReady = views.every((view) => view.isReady(player.timeS));
  player.advance(nowMs, isReady);
  if (wasPlaying && player.isPlaying) views.forEach((view) => view.resume());
  if (player.timeS !== askedS && nowMs - askedMs > FIGURES_EVERY_MS && connection.isOpen) {
    [askedS, askedMs] = [player.timeS, nowMs];
    connection.send("figures", { t_s: askedS });
  }
  views.forEach((view) => view.draw(player.timeS, player.speed, nowMs));
}

function setLink(level, text) {
  const pill = byId("link-state");
  pill.dataset.level = level;
  pill.querySelector("b").textContent = text;
}

function sentence(text) {
  return text.charAt(0).toUpperCase() + text.slice(1);
}

requestAnimationFrame(draw);

// What is written on the scene: names, ruler, force arrow, the hand's wanted position, and the rings of a breach.

import { CONTACT } from "./wire.js";
import { palette } from "./palette.js";

export const RULER_PX = 54;

const ARROW_PX_PER_N = 26;
const ARROW_ROOM_PX = 12; // between its head and the edge of the picture
const RIPPLE_MS = 900;
const MM = 1e-3;
const RULER_STEPS_MM = [1, 2, 5, 10, 20, 50, 100, 200];
const RULER_GAP_PX = 40; // at least, between two numbers
const FONT = "Inter, system-ui, sans-serif";

/** Names, strengths and states of the tissues, where the server has told them. */
export function drawLabels(context, scene) {
  const colour = palette();
  const width = scene.middle - 40;
  context.textAlign = "left";
  context.textBaseline = "alphabetic";
  scene.tissues.forEach((tissue, index) => {
    if (!tissue.name) return;
    const top = scene.y(tissue.rest_m);
    const room = (index + 1 < scene.tissues.length ? scene.y(scene.tissues[index + 1].rest_m) : scene.height) - top;
    if (room < 20) return;
    const y = top + Math.min(26, room * 0.45);
    context.strokeStyle = context.fillStyle = colour(`on-tissue-${scene.shade(index)}`);
    context.font = `600 ${scene.isPlain ? 22 : 13}px ${FONT}`;
    context.fillText(shortened(context, tissue.name, width), 16, y);
    if (room < 72 || scene.isPlain) return;
    context.font = `400 12px ${FONT}`;
    context.fillText(strength(tissue, width), 16, y + 17);
    drawContact(context, scene, index, y + 35);
  });
}

function shortened(context, text, width) {
  if (context.measureText(text).width <= width) return text;
  let kept = text;
  while (kept && context.measureText(`${kept}…`).width > width) kept = kept.slice(0, -1);
  return `${kept}…`;
}

function strength({ breach_force_n: breach, stiffness_n_per_m: stiffness }, width) {
  if (breach === undefined) return "";
  const breaks = `breaks at ${Number(breach.toPrecision(2))} N`;
  return width < 150 ? breaks : `${Number(stiffness.toPrecision(3))} N/m, ${breaks}`;
}

/** State of a tissue as a small symbol and words, so that colour is never needed. */
function drawContact(context, scene, index, y) {
  const contact = scene.contact(index);
  const strain = scene.strain(index);
  const x = 21;
  const middle = y - 4;
  context.lineWidth = 1.5;
  context.beginPath();
  if (contact === CONTACT.PENETRATED) {
    context.moveTo(x - 4, middle - 4);
    context.lineTo(x + 4, middle + 4);
    context.moveTo(x + 4, middle - 4);
    context.lineTo(x - 4, middle + 4);
    context.stroke();
  } else {
    context.arc(x, middle, 4.5, 0, 2 * Math.PI);
    context.stroke();
    if (contact === CONTACT.INDENTED) {
      context.beginPath();
      context.moveTo(x, middle);
      context.arc(x, middle, 4.5, -Math.PI / 2, -Math.PI / 2 + 2 * Math.PI * Math.min(1, strain || 0.5));
      context.fill();
    }
  }
  const words = contact === CONTACT.PENETRATED ? "breached" : contact === CONTACT.INDENTED ? pressed(strain) : "intact";
  context.font = `500 12px ${FONT}`;
  context.fillText(words, 32, y);
}

function pressed(strain) {
  return Number.isFinite(strain) ? `pressed, ${Math.round(100 * Math.min(1, strain))} %` : "pressed";
}

/** A ruler beside the tissues, with the tip's depth. */
export function drawRuler(context, scene, wantedM) {
  const colour = palette();
  const left = scene.width;
  context.fillStyle = colour("surface");
  context.fillRect(left, 0, RULER_PX, scene.height);
  context.fillStyle = colour("line");
  context.fillRect(left, 0, 1, scene.height);
  context.textAlign = "left";
  context.textBaseline = "middle";
  context.font = `400 11px ${FONT}`;
  const tipY = scene.y(scene.tipM);
  const [low, high] = scene.rangeM;
  const step = RULER_STEPS_MM.find((mm) => scene.y(mm * MM) - scene.y(0) >= RULER_GAP_PX) ?? 500;
  for (let k = Math.ceil((2 * low) / MM / step); k * step <= (2 * high) / MM + 1e-6; k += 1) {
    const mm = (k * step) / 2;
    const y = Math.round(scene.y(mm * MM)) + 0.5;
    const whole = k % 2 === 0;
    context.fillStyle = colour(whole ? "muted" : "line-strong");
    context.fillRect(left, y - 0.5, whole ? 9 : 5, 1);
    if (whole && Math.abs(y - tipY) > 15) context.fillText(`${mm}`, left + 14, y);
  }
  context.fillStyle = colour("muted");
  if (tipY > 40) context.fillText("mm", left + 14, 16);
  if (wantedM !== null) {
    context.strokeStyle = colour("hand");
    context.lineWidth = 2;
    context.beginPath();
    context.moveTo(left + 1, scene.y(wantedM));
    context.lineTo(left + 12, scene.y(wantedM));
    context.stroke();
  }
  drawTip(context, scene, left, Math.min(scene.height - 11, Math.max(11, tipY)), colour); // also of a tip out of sight
}

function drawTip(context, scene, left, y, colour) {
  context.fillStyle = colour("ink");
  context.beginPath();
  context.moveTo(left + 1, y);
  context.lineTo(left + 10, y - 10);
  context.lineTo(left + RULER_PX - 4, y - 10);
  context.lineTo(left + RULER_PX - 4, y + 10);
  context.lineTo(left + 10, y + 10);
  context.closePath();
  context.fill();
  context.fillStyle = colour("surface");
  context.font = `600 11.5px ${FONT}`;
  context.textAlign = "right";
  context.fillText((scene.tipM * 1000).toFixed(1).replace("-", "−"), left + RULER_PX - 9, y + 0.5);
}

/** Where the hand wants the tip: the needle follows behind it. */
export function drawWanted(context, scene, needle, wantedM) {
  const y = scene.y(wantedM);
  const colour = palette()("hand");
  const apart = Math.abs(y - needle.y);
  context.strokeStyle = colour;
  context.globalAlpha = Math.min(1, 0.35 + apart / 60);
  context.lineWidth = 1.5;
  context.setLineDash([2, 4]);
  context.beginPath();
  context.moveTo(needle.x + 14, y);
  context.lineTo(scene.width, y);
  context.stroke();
  context.setLineDash([]);
  context.beginPath();
  context.arc(needle.x, y, needle.radius + 4, 0, 2 * Math.PI);
  context.stroke();
  context.globalAlpha = 1;
}

/**
 * A force as an arrow from where it acts. Its head stays in the picture; if it is cut, the words say so.
 * @param {object} push x and y of the force on the tool [N] in the picture
 * @param {number} forceN as written
 */
export function drawForce(context, from, push, forceN, { width, height }) {
  const length = Math.hypot(push.x, push.y) * ARROW_PX_PER_N;
  if (!(Math.abs(forceN) > 0.03)) return; // what a deadband may leave at rest
  const inside = (at, by, size) => (by ? ((by > 0 ? size - ARROW_ROOM_PX : ARROW_ROOM_PX) - at) / by : 1); // 0 may be -0
  const [x, y] = [push.x * ARROW_PX_PER_N, push.y * ARROW_PX_PER_N];
  const share = Math.max(0, Math.min(1, inside(from.x, x, width), inside(from.y, y, height)));
  const colour = palette();
  const to = share * length;
  const head = Math.min(10, to);
  const path = new Path2D();
  for (const [across, forward] of [[-2.5, 0], [-2.5, to - head], [-8, to - head], [0, to], [8, to - head], [2.5, to - head], [2.5, 0]]) {
    path.lineTo(across, -forward);
  }
  path.closePath();
  context.save();
  context.translate(from.x, from.y);
  context.rotate(Math.atan2(x, -y));
  context.lineJoin = "round";
  context.strokeStyle = colour("surface");
  context.lineWidth = 4;
  context.stroke(path);
  context.fillStyle = colour("held");
  context.fill(path);
  context.restore();
  const words = `${forceN.toFixed(2).replace("-", "−")} N${share < 1 ? ", not to scale" : ""}`;
  context.font = `700 15px ${FONT}`;
  const wide = context.measureText(words).width + 16;
  const left = Math.min(from.x + (share * x) / 2 + 13, width - wide - 4);
  const middle = Math.min(height - 18, Math.max(18, from.y + (share * y) / 2));
  context.fillStyle = colour("surface");
  context.beginPath();
  context.roundRect(left, middle - 13, wide, 26, 13);
  context.fill();
  context.fillStyle = colour("held-text");
  context.textAlign = "left";
  context.textBaseline = "middle";
  context.fillText(words, left + 8, middle + 0.5);
}

/** A bar that says how long a millimetre is. */
export function drawScale(context, pxPerM) {
  const mm = RULER_STEPS_MM.find((each) => each * MM * pxPerM >= RULER_GAP_PX) ?? 500;
  context.strokeStyle = context.fillStyle = palette()("muted");
  context.lineWidth = 1.5;
  const path = new Path2D();
  for (const [x, y] of [[0, 0], [0, 6], [mm * MM * pxPerM, 6], [mm * MM * pxPerM, 0]]) path.lineTo(18 + x, 28 + y);
  context.stroke(path);
  context.font = `400 11px ${FONT}`;
  context.textAlign = "left";
  context.textBaseline = "alphabetic";
  context.fillText(`${mm} mm`, 18, 23);
}

/** Chevrons below the tip that invite to drag. */
export function drawInvitation(context, needle, nowMs, still) {
  context.strokeStyle = palette()("hand");
  context.lineWidth = 2.5;
  context.lineCap = context.lineJoin = "round";
  const phase = still ? 0.5 : (nowMs / 1400) % 1;
  for (let k = 0; k < 3; k += 1) {
    const y = needle.y + 16 + 11 * k + (still ? 0 : 5 * phase);
    context.globalAlpha = still ? 0.5 : 0.7 * Math.max(0, Math.sin(Math.PI * ((phase * 1.6 - k * 0.2) % 1.6)));
    context.beginPath();
    context.moveTo(needle.x - 8, y);
    context.lineTo(needle.x, y + 6);
    context.lineTo(needle.x + 8, y);
    context.stroke();
  }
  context.globalAlpha = 1;
  context.lineCap = "butt";
}

/** Rings where a surface was pierced. Returns those that are not over. */
export function drawRipples(context, scene, ripples, nowMs, still) {
  const rest = ripples.filter(({ startMs }) => nowMs - startMs < RIPPLE_MS);
  if (still) return rest;
  context.strokeStyle = palette()("tissue-edge");
  for (const { index, startMs } of rest) {
    const age = (nowMs - startMs) / RIPPLE_MS;
    const y = scene.y(scene.tissues[index].rest_m);
    for (const lag of [0, 0.18]) {
      const grown = (age - lag) / (1 - lag);
      if (grown <= 0) continue;
      const eased = 1 - (1 - grown) ** 3;
      context.globalAlpha = (1 - grown) ** 1.5;
      context.lineWidth = 3 * (1 - grown) + 0.5;
      context.beginPath();
      context.ellipse(scene.middle, y, 10 + 110 * eased, 3 + 22 * eased, 0, 0, 2 * Math.PI);
      context.stroke();
    }
  }
  context.globalAlpha = 1;
  return rest;
}

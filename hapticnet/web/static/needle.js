// Drawing of the needle: a steel shaft with a mark every 10 mm, a ground tip, and a hub.

import { palette } from "./palette.js";

const MARK_M = 0.01;
const TIP_LENGTH = 5.2; // in radii

/** Outline of shaft and tip. */
export function needlePath({ x, y, radius }, lengthPx) {
  const path = new Path2D();
  const shoulder = y - TIP_LENGTH * radius;
  path.moveTo(x - radius, y - lengthPx);
  path.lineTo(x - radius, shoulder);
  path.quadraticCurveTo(x - radius * 0.75, y - radius * 1.6, x, y);
  path.quadraticCurveTo(x + radius * 0.75, y - radius * 1.6, x + radius, shoulder);
  path.lineTo(x + radius, y - lengthPx);
  path.closePath();
  return path;
}

export function drawNeedle(context, needle, lengthPx) {
  const colour = palette();
  const { x, y, radius, scale } = needle;
  const steel = context.createLinearGradient(x - radius, 0, x + radius, 0);
  steel.addColorStop(0, colour("steel-dark"));
  steel.addColorStop(0.28, colour("steel-light"));
  steel.addColorStop(0.55, colour("steel"));
  steel.addColorStop(1, colour("steel-dark"));
  context.fillStyle = colour("needle-shadow");
  context.fillRect(x + radius, y - lengthPx, 3, lengthPx - TIP_LENGTH * radius);
  const outline = needlePath(needle, lengthPx);
  context.fillStyle = steel;
  context.fill(outline);
  context.strokeStyle = colour("steel-line");
  context.lineWidth = 0.8;
  context.stroke(outline);
  drawBevel(context, needle, colour);
  context.fillStyle = colour("steel-mark");
  for (let mark = 1; mark * MARK_M * scale < lengthPx - 8; mark += 1) {
    const height = mark % 5 === 0 ? 3 : 1.5;
    context.fillRect(x - radius, y - mark * MARK_M * scale, 2 * radius, height);
  }
  drawHub(context, needle, lengthPx, colour);
}

/** The ground face of the tip. */
function drawBevel(context, { x, y, radius }, colour) {
  const shoulder = y - TIP_LENGTH * radius;
  context.beginPath();
  context.moveTo(x, y - 1);
  context.quadraticCurveTo(x + radius * 0.7, y - radius * 1.6, x + radius * 0.55, shoulder + radius);
  context.quadraticCurveTo(x + radius * 0.1, shoulder - radius * 0.4, x - radius * 0.25, shoulder + radius);
  context.closePath();
  context.fillStyle = colour("steel-bevel");
  context.fill();
}

function drawHub(context, { x, y, radius }, lengthPx, colour) {
  const bottom = y - lengthPx;
  if (bottom < -4) return;
  const narrow = radius * 2;
  const wide = radius * 3.4;
  context.fillStyle = colour("hub");
  context.beginPath();
  context.moveTo(x - narrow, bottom);
  context.lineTo(x + narrow, bottom);
  context.lineTo(x + wide, bottom - 5 * radius);
  context.lineTo(x + wide, -10);
  context.lineTo(x - wide, -10);
  context.lineTo(x - wide, bottom - 5 * radius);
  context.closePath();
  context.fill();
  context.strokeStyle = colour("steel-line");
  context.lineWidth = 1;
  context.stroke();
  context.fillStyle = colour("hub-shine");
  context.fillRect(x - wide * 0.55, -10, wide * 0.3, bottom - 5 * radius + 10);
}

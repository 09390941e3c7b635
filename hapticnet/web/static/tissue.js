// Drawing of the tissues: bodies, the lines inside them, the glow under the tip, and what covers the needle.

import { CONTACT } from "./wire.js";
import { needlePath } from "./needle.js";
import { palette } from "./palette.js";

const LAMELLAE = 5;
const LAMELLA_DASHES = [[], [7, 5], [1.5, 5], [12, 4, 2, 4], [3, 3]]; // tell layers apart without colour
const LAST_LAYER_M = 0.026; // depth over which the lines of the last layer are spread
const FADE = [[0, 0.3], [0.5, 1], [1, 0.3]];
const FADE_BEHIND_NAMES = [[0, 0.15], [0.15, 0.15], [0.45, 1], [1, 0.6]];

/** Return the fills that change only with size, scene and theme. */
export function makeFills(context, scene) {
  const colour = palette();
  const down = (from, to, ...stops) => {
    const fill = context.createLinearGradient(0, from, 0, to);
    stops.forEach((stop, index) => fill.addColorStop(index / (stops.length - 1), stop));
    return fill;
  };
  const fade = scene.tissues.some(({ name }) => name) ? FADE_BEHIND_NAMES : FADE;
  const across = (name) => {
    const fill = context.createLinearGradient(0, 0, scene.width, 0);
    const [red, green, blue, alpha] = colour(name).split(" ");
    for (const [at, share] of fade) fill.addColorStop(at, `rgb(${red} ${green} ${blue} / ${Number(alpha) * share})`);
    return fill;
  };
  return {
    sky: down(0, scene.height, colour("sky-top"), colour("sky-bottom")),
    lamellae: [across("lamella"), across("lamella-deep")],
    layers: scene.tissues.map(({ rest_m: rest }, index) => {
      const next = scene.tissues[index + 1]?.rest_m ?? rest + LAST_LAYER_M;
      const shade = scene.shade(index);
      return down(scene.y(rest), scene.y(next), colour(`tissue-${shade}`), colour(`tissue-${shade}-deep`));
    }),
  };
}

/** @param {number[][]} surfaces heights [px] of each surface at `scene.stationsPx` */
export function drawTissues(context, scene, surfaces) {
  const colour = palette();
  context.lineJoin = "round";
  surfaces.forEach((heights, index) => {
    const edge = trace(scene, heights);
    const body = new Path2D(edge);
    // A body ends below the lowest point of the next surface, which covers the rest.
    const bottom = index + 1 < surfaces.length ? Math.max(...surfaces[index + 1]) + 1 : scene.height;
    body.lineTo(scene.width + 2, bottom);
    body.lineTo(-2, bottom);
    context.fillStyle = scene.fills.layers[index];
    context.fill(body);
    drawLamellae(context, scene, heights, surfaces[index + 1], index);
    drawGlow(context, scene, body, index);
    context.strokeStyle = colour("tissue-shadow");
    context.lineWidth = 7;
    context.translate(0, 4);
    context.stroke(edge);
    context.translate(0, -4);
    context.strokeStyle = colour("tissue-edge");
    context.lineWidth = 2;
    context.stroke(edge);
  });
}

function trace(scene, heights) {
  const path = new Path2D();
  heights.forEach((height, at) => path.lineTo(scene.stationsPx[at], height));
  return path;
}

/** Lines inside a layer that follow both its surfaces: they show how the tissue is compressed. */
function drawLamellae(context, scene, heights, below, index) {
  const floor = scene.y(scene.tissues[index].rest_m + LAST_LAYER_M);
  context.strokeStyle = scene.fills.lamellae[scene.shade(index) > 3 ? 1 : 0];
  context.lineWidth = 1.2;
  context.setLineDash(LAMELLA_DASHES[scene.isPlain ? 0 : index % LAMELLA_DASHES.length]);
  context.beginPath(); // one stroke for all lines of a layer takes half the time
  for (let k = 1; k <= LAMELLAE; k += 1) {
    const share = k / (LAMELLAE + 1);
    heights.forEach((height, at) => {
      const y = height + share * (Math.max(height, below?.[at] ?? floor) - height);
      if (at === 0) context.moveTo(scene.stationsPx[at], y);
      else context.lineTo(scene.stationsPx[at], y);
    });
  }
  context.stroke();
  context.setLineDash([]);
}

/** A glow under the tip that grows until the tissue gives way. Only where its strength is known. */
function drawGlow(context, scene, body, index) {
  const strain = Math.min(1, scene.strain(index));
  if (!(strain > 0.01)) return;
  const x = scene.middle;
  const y = scene.y(scene.tipM);
  const reach = scene.y(0.006 + 0.009 * strain) - scene.y(0);
  const glow = context.createRadialGradient(x, y, 1, x, y, reach);
  for (const [at, share] of [[0, 0.85], [0.45, 0.3], [1, 0]]) {
    glow.addColorStop(at, `rgb(${palette()("glow")} / ${strain * share})`);
  }
  context.save();
  context.clip(body);
  context.fillStyle = glow;
  context.fillRect(x - reach, y - reach, 2 * reach, 2 * reach);
  context.restore();
}

/** Tint the part of the needle that is inside, so that it looks embedded, and draw the rims of the holes. */
export function drawTissueOverNeedle(context, scene, surfaces, needle, lengthPx) {
  const pierced = surfaces
    .map((heights, index) => ({ index, top: heights[Math.floor(heights.length / 2)] }))
    .filter(({ index, top }) => scene.contact(index) === CONTACT.PENETRATED && needle.y > top);
  context.save();
  context.clip(needlePath(needle, lengthPx));
  context.globalAlpha = 0.3;
  for (const { index, top } of pierced) {
    context.fillStyle = scene.fills.layers[index];
    context.fillRect(needle.x - needle.radius, top, 2 * needle.radius, scene.height);
  }
  context.restore();
  context.strokeStyle = palette()("hole");
  context.lineWidth = 2;
  for (const { top } of pierced) {
    context.beginPath();
    context.ellipse(needle.x, top, needle.radius * 1.7, needle.radius * 0.55, 0, 0, Math.PI);
    context.stroke();
  }
}

// The tiles: packets and bytes of the feedback beside what the same would cost uncompressed, and how wrong it feels.

import { bytes, count, joules, percent, signed } from "./words.js";

export function showTraffic(state) {
  const { feedback, forward } = state;
  tile("tile-packets", count(feedback.packets_per_s), "/s", ratio(feedback.packets_per_s, feedback.raw_packets_per_s),
    `of ${count(feedback.raw_packets_per_s)}`);
  const [[size, unit], [raw, rawUnit]] = [bytes(feedback.bytes_per_s), bytes(feedback.raw_bytes_per_s)];
  text("bytes", `${size} ${unit === rawUnit ? "" : `${unit} `}of ${raw} ${rawUnit}/s`);
  const left = ratio(feedback.packets, feedback.raw_packets);
  const leftBytes = ratio(feedback.bytes, feedback.raw_bytes);
  tile("tile-saved", left === null ? "–" : percent(Math.max(0, 1 - left)), "%", left === null ? null : 1 - left,
    leftBytes === null ? "until a force is felt" : `bytes: ${percent(Math.max(0, 1 - leftBytes))} %, while felt`);
  tile("tile-link", state.round_trip_ms === null ? "–" : signed(state.round_trip_ms, state.round_trip_ms < 10 ? 2 : 1), "ms");
  text("lost", `${count(state.lost)} of ${count(state.arrived + state.lost)} lost`);
  const [out, outUnit] = bytes(forward.bytes_per_s);
  showFelt(state.felt);
  showEnergy(state.port);
  text("forward", `Positions ${out} ${outUnit}/s`);
}

/** The energy at the master's port, where the force can move the hand. */
function showEnergy(port) {
  const box = document.getElementById("tile-energy");
  box.hidden = !port;
  if (!port) return;
  tile("tile-energy", ...joules(port.created_j), null);
  text("put-in", `${joules(port.put_in_j).join(" ")} put in`);
  text("given-back", `${joules(port.given_back_j).join(" ")} given back`);
  text("swings", port.swings ? "The hand swings" : "");
  box.dataset.level = port.swings ? "bad" : "";
}

/** How far the held force was from the true one at the same moment, over the seconds shown. */
function showFelt(felt) {
  const box = document.getElementById("tile-felt");
  box.hidden = !felt;
  if (!felt) return;
  tile("tile-felt", percent(felt.exceed_jnd_fraction), "%", felt.exceed_jnd_fraction);
  const shares = [1, 2, 4, 8].map((jnds) => felt[jnds === 1 ? "exceed_jnd_fraction" : `above_${jnds}_jnd_fraction`]);
  box.title = "Held force beside the true one, over the seconds shown: above 1, 2, 4 and 8 JND "
    + `${shares.map((share) => `${percent(share)} %`).join(", ")} of the time; RMSE ${felt.rmse_n.toFixed(2)} N, `
    + `99 % within ${felt.p99_error_n.toFixed(2)} N, largest ${felt.max_error_n.toFixed(2)} N`;
}

function ratio(part, whole) {
  return whole > 0 ? part / whole : null;
}

function tile(id, number, unit, share, note) {
  const box = document.getElementById(id);
  const [value, small] = box.querySelectorAll(".big > *");
  if (value.textContent !== number) value.textContent = number;
  if (small.textContent !== unit) small.textContent = unit;
  const bar = box.querySelector(".bar i");
  if (bar) bar.style.width = `${100 * Math.min(1, Math.max(0, share ?? 0))}%`;
  const noteBox = note && box.querySelector(".quiet");
  if (noteBox && noteBox.textContent !== note) noteBox.textContent = note;
}

function text(id, words) {
  const box = document.getElementById(id);
  if (box.textContent !== words) box.textContent = words;
}

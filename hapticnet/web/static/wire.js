// The binary messages of hapticnet/web/messages.py. Pure functions: no sockets, no document.

export const HAND_STATES = ["free", "live", "holding", "withdrawing"];
export const CONTACT = Object.freeze({ NONE: 0, INDENTED: 1, PENETRATED: 2 });

const FRAME = 1;
const SAMPLES = 2;
const VIBRATION = 3;
const HAND = 1;
const HAND_BYTES = 16;
const FRAME_HEAD = 20;
const SAMPLES_HEAD = 16;
const VIBRATION_HEAD = 4;

/** Return the message in an ArrayBuffer, or null if it is of a kind this page does not know. */
export function decode(buffer) {
  const view = new DataView(buffer);
  if (buffer.byteLength >= FRAME_HEAD && view.getUint8(0) === FRAME) return decodeFrame(view);
  if (buffer.byteLength >= SAMPLES_HEAD && view.getUint8(0) === SAMPLES) return decodeSamples(view);
  if (buffer.byteLength >= VIBRATION_HEAD && view.getUint8(0) === VIBRATION) return decodeVibration(view);
  return null;
}

function decodeVibration(view) {
  const count = view.getUint16(2, true);
  if (view.byteLength < VIBRATION_HEAD + 4 * count) return null;
  return { kind: "vibration", playedMS2: new Float32Array(view.buffer, VIBRATION_HEAD, count) };
}

function decodeFrame(view) {
  const surfaces = view.getUint16(2, true);
  const more = view.byteLength - FRAME_HEAD - 5 * surfaces;
  if (more < 0) return null;
  return {
    kind: "frame",
    handState: HAND_STATES[view.getUint8(1)] ?? "free",
    number: view.getUint32(4, true),
    handTimeMs: view.getFloat64(8, true),
    tipM: view.getFloat32(16, true),
    surfacesM: new Float32Array(view.buffer, FRAME_HEAD, surfaces),
    contacts: new Uint8Array(view.buffer, FRAME_HEAD + 4 * surfaces, surfaces),
    // With several axes: the further ones, and the held force for a view that shows it.
    further: surfaces ? [] : [...new Float32Array(view.buffer, FRAME_HEAD, more >> 2)],
  };
}

function decodeSamples(view) {
  const columns = view.getUint8(1);
  const rows = view.getUint16(2, true);
  if (view.byteLength < SAMPLES_HEAD + 4 * columns * rows) return null;
  return {
    kind: "samples",
    rows,
    firstRow: view.getUint32(4, true),
    startS: view.getFloat64(8, true),
    columns: Array.from(
      { length: columns },
      (_, column) => new Float32Array(view.buffer, SAMPLES_HEAD + 4 * column * rows, rows),
    ),
  };
}

/** Return the HAND message for a wanted tip position [m] on each axis and the time stamp [ms] of the motion. */
export function encodeHand([firstM, ...furtherM], timeMs) {
  const view = new DataView(new ArrayBuffer(HAND_BYTES + 4 * furtherM.length));
  view.setUint8(0, HAND);
  view.setFloat32(4, firstM, true);
  view.setFloat64(8, timeMs, true);
  furtherM.forEach((positionM, axis) => view.setFloat32(HAND_BYTES + 4 * axis, positionM, true));
  return view.buffer;
}

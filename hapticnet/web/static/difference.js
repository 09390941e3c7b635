// What the packets of one recording cost beside those of another, and how it felt, in words. Pure functions.

import { count, percent } from "./words.js";

/** Return a sentence or two about one or two recordings, from their descriptions. */
export function difference(tapes) {
  const found = tapes.map(({ label, summary }) => ({ label, ...summary, named: summary.codecs.slice(0, 3).join(" then ") || "without codec" }));
  const when = found.every(({ is_felt: isFelt }) => isFelt) ? "while a force was felt" : "over the whole recording";
  return `${sent(found, when)} ${felt(found)}`.trim();
}

function sent(found, when) {
  if (found.some(({ packets_per_s: rate }) => rate === null)) {
    return found.length > 1 ? "How many packets they sent cannot be compared, because a recording has none." : "";
  }
  if (found.length === 1) {
    const [{ named, packets_per_s: rate, raw_per_s: raw }] = found;
    return `${named.charAt(0).toUpperCase()}${named.slice(1)} sent ${fewer(rate, raw)} sending each sample would have, ${when}.`;
  }
  const [few, many] = [...found].sort((a, b) => a.packets_per_s - b.packets_per_s);
  const name = ({ label, named }) => `${label} (${named})`;
  return `${name(few)} sent ${fewer(few.packets_per_s, many.packets_per_s)} ${name(many)}: ${count(few.packets_per_s)} against `
    + `${count(many.packets_per_s)} a second ${when}.`;
}

function felt(found) {
  const share = ({ label, above_jnd: above }) => `${label} ${percent(above)} %`.trim();
  const known = found.filter(({ above_jnd: above }) => above !== null);
  const unknown = found.filter(({ above_jnd: above }) => above === null).map(({ label }) => label);
  const words = known.length ? [`More than one JND from the true force: ${known.map(share).join(", ")} of the time.`] : [];
  if (unknown.length) words.push(`The error of the held force is not known${unknown[0] ? ` in ${unknown.join(" and ")}` : ""}.`);
  return words.join(" ");
}

function fewer(few, many) {
  const share = many > 0 ? 1 - few / many : 0;
  return share < 0.0005 ? "as many packets as" : `${percent(share)} % fewer packets than`;
}

// The page: a tab that is a master. Hand, hold, codec and keys are here; the gateway only carries datagrams.

import { GatewayLink, type LinkState } from "../src/gateway.js";
import { formatKey, Master, newKey, now, publicKey, run, type Codec, type MasterKeys, type MasterOptions, type RunOptions } from "../src/index.js";
import { Hand } from "./hand.js";
import { Picture, Ticks } from "./picture.js";

/** As often as a pointer says where it is. If each position is sent, each takes a gateway about 0.4 ms of a processor, both ways. */
const RATE_HZ = 250;
/** Few positions: the share of the JND that they may use, as `hapticnet master --positions line` has it. */
const POSITION_SHARE = 0.25;
/** A slave keeps the scene of a silent master for 30 s; the session that is asked for then continues it. */
const SLOW_MS = 1000;
/** After so long without an answer, the page says what may be wrong. */
const PATIENT_US = 3e6;
/** Codes of a refusal: the codec, or a parameter or the perception, is not known. */
const NOT_KNOWN: readonly number[] = [2, 3];

const byId = <T extends HTMLElement>(id: string) => document.getElementById(id) as T;
const fields = byId<HTMLFormElement>("settings");
const given = new URLSearchParams(location.hash.slice(1));
const ticks = new Ticks();
/** For tests and the console: the newest ticks, and a hand that takes the place of the pointer. */
const open = { ticks, hand: undefined as ((nowUs: number) => number[] | undefined) | undefined, link: undefined as GatewayLink | undefined };
Object.assign(globalThis, { hapticnet: open });

/** Show a state by a sign, words and a colour. */
function show(id: string, level: "good" | "wait" | "bad", words: string): void {
  const pill = byId(id);
  pill.dataset.level = level;
  if (pill.textContent !== words) pill.textContent = words;
}

const value = (name: string) => (fields.elements.namedItem(name) as HTMLInputElement | HTMLSelectElement).value.trim();

/** Return the keys of the form; undefined for an open session. */
function keys(): MasterKeys | undefined {
  const [own, slave, psk] = [value("key"), value("slave"), value("psk")];
  if (own === "" && slave === "") return undefined;
  if (own === "" || slave === "") throw new RangeError("A sealed session needs your private key and the slave's public key.");
  return psk === "" ? { private: own, slave } : { private: own, slave, psk };
}

/** Keep the settings in the fragment of the address (after #), which browsers never send. */
function remember(): void {
  for (const name of ["token", "gateway", "slave", "key", "psk", "codec", "positions", "axes", "multiplier"])
    if (value(name) === "") given.delete(name);
    else given.set(name, value(name));
  history.replaceState(null, "", `#${given}`);
}

/** Return a function that waits some time [ms], also while the page is hidden. */
function patient(): (ms: number) => Promise<void> {
  const worker = new Worker(new URL("ticker.js", document.baseURI));
  return (ms) =>
    new Promise((resolve) => {
      worker.onmessage = () => resolve();
      worker.postMessage(ms);
    });
}

const LINK: Readonly<Record<LinkState, "good" | "wait" | "bad">> = {
  connecting: "wait",
  open: "good",
  waiting: "wait",
  refused: "bad",
  closed: "bad",
};

/** Say what the slave is doing, and what to do about it. */
function said(master: Master, link: LinkState, silentUs: number): string {
  const words = master.notice?.text;
  if (master.state === "established") return `touching ${master.scene}`;
  if (link !== "open") return "no force without the gateway";
  if (master.state === "stale") return "no force: the slave is silent";
  if (words) return `no force; the slave says: ${words}; asking again`;
  if (silentUs < PATIENT_US) return "asking the slave";
  return `the slave does not answer: does it run${value("slave") === "" ? "" : ", and is this its public key"}?`;
}

/** Say what the slave granted of few positions and a predicted hand, if they were asked for. */
function granted(master: Master, few: boolean): string {
  const { fewPositions = false, predicted = false } = master.granted ?? {};
  const sent = fewPositions ? "few positions, often 10 to 20 a second" : few ? "each position is sent: the slave sends no answer to few positions" : "each position is sent";
  return few || predicted ? `${sent}; the slave ${predicted ? "predicts" : "does not predict"} your hand` : sent;
}

/** Touch the slave's scene until the end of the session. */
async function touch(): Promise<void> {
  const sealed = keys();
  const axes = Number(value("axes"));
  let few = value("positions") === "few";
  let codec = value("codec") as Codec;
  let without = "";
  const ask = (more: MasterOptions) =>
    new Master({ name: "browser tab", codec, axes, rateHz: RATE_HZ, ...(sealed === undefined ? {} : { keys: sealed }), ...more });
  const multiplier = Number(value("multiplier"));
  let master = ask({ multiplier, ...(few ? { positionShare: POSITION_SHARE, predicted: true } : {}) });
  const picture = new Picture(byId<HTMLCanvasElement>("scene"));
  const hand = new Hand(picture.canvas, axes, () => picture.metresPerPixel());
  byId("let-go").onclick = () => hand.letGo();
  const link = (open.link = new GatewayLink({
    url: value("gateway") || location.href,
    token: value("token"),
    onstate: (state, reason) => show("link", LINK[state], state === "waiting" ? `${reason}; trying again` : reason),
  }));
  show("seal", sealed === undefined ? "wait" : "good", sealed === undefined ? "open: not encrypted to the slave" : "sealed");
  document.addEventListener("visibilitychange", () => {
    if (!document.hidden && link.state !== "open") link.reconnect("this page is seen again");
  });
  let forceN: number[] = [];
  let placeM: number[] | undefined;
  let placeUs = 0;
  let heardUs = now();
  const shown = () => {
    picture.draw(now(), ticks, hand.placeM, forceN);
    const force = Math.hypot(...forceN);
    byId("force").textContent = `${force.toFixed(2)} N`;
    picture.canvas.setAttribute("aria-valuenow", (1000 * (hand.placeM[0] ?? 0)).toFixed(0));
    picture.canvas.setAttribute("aria-valuetext", `${(1000 * (hand.placeM[0] ?? 0)).toFixed(0)} mm, ${force.toFixed(1)} newtons`);
    const { state } = master;
    if (link.state !== "open" || state === "established") heardUs = now();
    if (state === "connecting") show("granted", "wait", without);
    if (state === "established") {
      show("granted", few && !master.granted?.fewPositions ? "wait" : "good", without + granted(master, few));
    }
    if (state !== "closing" && state !== "closed") show("session", state === "established" ? "good" : "wait", said(master, link.state, now() - heardUs));
    requestAnimationFrame(shown);
  };
  requestAnimationFrame(shown);
  let before = { ...link.carried, bytes: 0 };
  setInterval(async () => {
    const stats = await link.stats();
    const carried = { ...link.carried, bytes: stats?.bytes ?? before.bytes };
    const trip = stats?.roundTripMs;
    byId("out").textContent = `${carried.sent - before.sent}/s`;
    byId("back").textContent = `${carried.received - before.received}/s`;
    byId("bytes").textContent = `${(Math.max(0, carried.bytes - before.bytes) / 1000).toFixed(1)} kB/s`;
    byId("dropped").textContent = `${carried.dropped - before.dropped}/s`;
    byId("trip").textContent = trip === undefined ? "–" : `${trip.toFixed(0)} ms`;
    before = carried;
  }, SLOW_MS);
  const options: RunOptions = {
    transport: link,
    sleep: patient(),
    hand: (nowUs) => {
      placeUs = nowUs;
      return (placeM = open.hand === undefined ? hand.at(nowUs) : open.hand(nowUs));
    },
    feel: (force) => {
      forceN = force;
      ticks.add(placeUs, placeM?.[0] ?? 0, force[0] ?? 0);
    },
  };
  let end = await run(master, options);
  if (NOT_KNOWN.includes(end?.code ?? 0) && (few || codec !== "deadband")) {
    without = `the slave refuses ${codec}: deadband is used; `;
    [few, codec] = [false, "deadband"];
    master = ask({ multiplier });
    end = await run(master, options);
  }
  link.close();
  show("granted", "wait", "");
  show("session", "bad", `${master.granted === undefined ? "The slave refuses" : "The slave ended the session"}: ${end?.text || "no reason given"}`);
}

function begin(): void {
  byId("wrong").textContent = "";
  try {
    remember();
    keys();
    fields.hidden = true;
    byId("touching").hidden = false;
    touch().catch(complain);
  } catch (error) {
    complain(error);
  }
}

/** Say what is wrong: at the form, if nothing was asked yet. */
function complain(error: unknown): void {
  const words = error instanceof Error ? error.message : String(error);
  if (open.link !== undefined) {
    show("session", "bad", words);
    return;
  }
  fields.hidden = false;
  byId("touching").hidden = true;
  byId("wrong").textContent = words;
}

for (const [name, text] of given) {
  const field = fields.elements.namedItem(name);
  if (field instanceof HTMLInputElement || field instanceof HTMLSelectElement) field.value = text;
}
byId("make-key").onclick = () => {
  const own = newKey();
  (fields.elements.namedItem("key") as HTMLInputElement).value = formatKey(own);
  (byId("entry").lastElementChild as HTMLElement).textContent = `[[master]]\nname = "browser tab"\npublic = "${formatKey(publicKey(own))}"`;
  byId("entry").hidden = false;
};
byId("change").onclick = () => {
  given.delete("begin");
  history.replaceState(null, "", `#${given}`);
  location.reload();
};
fields.onsubmit = (event) => {
  event.preventDefault();
  begin();
};
if (given.has("begin")) begin();

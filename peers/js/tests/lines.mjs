// The line protocol of peers/conformance/README.md, for Node and for a page: a line in, its answer out.
import { Master, Slave } from "../dist/index.js";

const CODECS = [
  "raw", "deadband", "adaptive-predictive", "linear-predictive", "least-squares", "level-crossing", "velocity-adaptive",
  "probabilistic", "merging",
];
const FEATURES = `language=JavaScript roles=master,slave codecs=${CODECS} slave_codecs=deadband,raw sealed=master,slave axes=3 also=-`;
const KEYS = { codec: "codec", name: "name", axes: "axes", rate: "rateHz", weber: "weberFraction", floor: "floorN", multiplier: "multiplier" };

const toHex = (bytes) => (bytes?.length ? Array.from(bytes, (byte) => byte.toString(16).padStart(2, "0")).join("") : "-");

function fromHex(text) {
  if (text === "-") return new Uint8Array();
  if (!/^([0-9a-f]{2})+$/i.test(text)) throw new Error(`${text} is not hex`);
  return Uint8Array.from(text.match(/../g), (pair) => parseInt(pair, 16));
}

const toText = (hex) => new TextDecoder("utf-8", { fatal: true }).decode(fromHex(hex));
const fromText = (text) => toHex(new TextEncoder().encode(text));

function toFloat(number) {
  const view = new DataView(new ArrayBuffer(8));
  view.setFloat64(0, number);
  return view.getBigUint64(0).toString(16).padStart(16, "0");
}

function fromFloat(hex) {
  if (!/^[0-9a-f]{16}$/i.test(hex)) throw new Error(`${hex} is not a float`);
  return new DataView(fromHex(hex).buffer).getFloat64(0);
}

function fromInt(text) {
  if (!/^-?\d+$/.test(text ?? "")) throw new Error(`${text} is not a number`);
  return Number(text);
}

/** Return a function that answers lines. */
export function conversation() {
  let words = [0], drawn = words, options = null, node = null, role = null;
  const random32 = () => (words.length > 1 ? words.shift() : words[0]);

  function start(kind, fields) {
    const given = { parameters: {}, random32 };
    for (const field of fields) {
      const [key, value] = field.split("=", 2);
      if (key.startsWith("p.")) given.parameters[key.slice(2)] = fromFloat(value);
      else if (key === "name" || key === "scene") given[key] = toText(value);
      else if (key === "axes") given.axes = fromInt(value);
      else if (key === "codec") given.codec = value;
      else if (key in KEYS) given[KEYS[key]] = fromFloat(value);
      else throw new Error(`there is no key ${key}`);
    }
    const before = [...words];
    node = kind === "master" ? new Master(given) : new Slave(given);
    [role, options, drawn] = [kind, given, before];
  }

  /** Make the node again, with keys: here, a node has its keys from the start. */
  function seal([own, ...rest]) {
    words = [...drawn];
    const psk = (text) => (text === "-" ? {} : { psk: fromHex(text) });
    const masters = [];
    for (let i = 0; i < rest.length; i += 2) masters.push({ public: fromHex(rest[i]), ...psk(rest[i + 1]) });
    if (role === "master") node = new Master({ ...options, keys: { private: fromHex(own), slave: fromHex(rest[0]), ...psk(rest[1]) } });
    else node = new Slave({ ...options, keys: { private: fromHex(own), masters } });
  }

  const vector = (fields) => {
    if (fields.length !== node.axes) throw new Error(`there are ${fields.length} numbers for ${node.axes} axes`);
    return fields.map(fromFloat);
  };
  const counts = () => `${node.counts.malformed} ${node.counts.stray} ${node.counts.tooOld}`;
  const general = {
    features: () => FEATURES,
    random: ([hex]) => {
      const bytes = fromHex(hex);
      if (bytes.length === 0 || bytes.length % 4) throw new Error("random needs whole words");
      words = Array.from({ length: bytes.length / 4 }, (_, i) => new DataView(bytes.buffer).getUint32(4 * i));
    },
    master: (fields) => start("master", fields),
    slave: (fields) => start("slave", fields),
  };
  const of = {
    master: {
      seal,
      counts,
      tick: ([now, ...at]) => node.tick(vector(at), fromInt(now)),
      force: ([now]) => node.force(fromInt(now)).map(toFloat).join(" "),
      send: () => {
        const sent = [];
        for (let data = node.send(); data; data = node.send()) sent.push(toHex(data));
        return sent.join(" ");
      },
      receive: ([now, data]) => node.receive(fromHex(data), fromInt(now)),
      close: ([now, why]) => node.close(toText(why), fromInt(now)),
      state: () => node.state,
      reason: () => `${node.notice?.code ?? 0} ${fromText(node.notice?.text ?? "")}`,
      scene: () => fromText(node.scene),
    },
    slave: {
      seal,
      counts,
      receive: ([now, data, address]) => toHex(node.receive(fromHex(data), address, fromInt(now))),
      position: () => node.position?.map(toFloat).join(" ") ?? "-",
      answer: ([now, ...force]) => toHex(node.answer(vector(force), fromInt(now))),
      close: ([code, why]) => toHex(node.close(toText(why), fromInt(code))),
      address: () => node.master ?? "-",
    },
  };

  return (line) => {
    try {
      const [command, ...fields] = line.split(" ");
      const call = Object.hasOwn(general, command) ? general[command] : role && Object.hasOwn(of[role], command) && of[role][command];
      if (!call) throw new Error(`there is no command ${command}${role ? ` of a ${role}` : ""}`);
      const answer = call(fields);
      return answer ? `ok ${answer}` : "ok";
    } catch (error) {
      return `error ${String(error.message).replaceAll(/\s+/g, " ")}`;
    }
  };
}

// The line protocol of peers/conformance/README.md, for Node and for a page: a line in, its answer out.

/** What the newest instance of the library exports, for what the package does not offer: numbers, a bare decoder. */
let exports;
WebAssembly.Instance = class extends WebAssembly.Instance {
  constructor(...given) {
    super(...given);
    exports = this.exports;
  }
};
const { Master, Slave } = await import("../dist/index.js");

const CODECS = [
  "raw", "deadband", "adaptive-predictive", "motion-predictive", "linear-predictive", "least-squares", "level-crossing",
  "velocity-adaptive", "passive-extrapolative", "passive-interpolative", "probabilistic", "merging", "model-mediated",
];

/** Return whether the library takes such a request. */
function takes(options) {
  try {
    return new Master(options).state === "connecting";
  } catch {
    return false;
  }
}

const MORE = { share: { positionShare: 0.25 }, announced: { announced: true }, predicted: { predicted: true } };
/** Without the limit on forces that follow the hand, the library decodes velocity-adaptive, but hapticnet limits it. */
const LIMITED = takes({ codec: "motion-predictive" }) ? [] : ["velocity-adaptive"];
const FEATURES = [
  "language=JavaScript roles=master,slave slave_codecs=deadband,raw sealed=master,slave axes=3 libm=own",
  `codecs=${CODECS.filter((codec) => !LIMITED.includes(codec) && takes({ codec }))}`,
  `also=${["sequence", "decoder", ...Object.keys(MORE).filter((name) => takes(MORE[name]))]}`,
].join(" ");
const ALL = { master: ["codec", "name", "axes", "rateHz", "weberFraction", "floorN", "multiplier"], slave: ["scene", "axes"] };
const KEYS = { rate: "rateHz", weber: "weberFraction", floor: "floorN", multiplier: "multiplier", share: "positionShare" };

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
  let words = [0], drawn = words, options = null, node = null, role = null, decoder = null, behind = null;
  const random32 = () => (words.length > 1 ? words.shift() : words[0]);

  function read(fields) {
    const given = { parameters: {}, random32 };
    for (const field of fields) {
      const [key, value] = field.split("=", 2);
      if (key.startsWith("p.")) given.parameters[key.slice(2)] = fromFloat(value);
      else if (key === "name" || key === "scene") given[key] = toText(value);
      else if (key === "axes") given.axes = fromInt(value);
      else if (key === "codec") given.codec = value;
      else if (key === "announced" || key === "predicted") given[key] = value === "1";
      else if (key in KEYS) given[KEYS[key]] = fromFloat(value);
      else throw new Error(`there is no key ${key}`);
    }
    return given;
  }

  function start(kind, fields) {
    const given = read(fields);
    const missing = ALL[kind].filter((key) => !(key in given));
    if (missing.length > 0) throw new Error(`${missing} is missing`);
    const before = [...words];
    node = kind === "master" ? new Master(given) : new Slave(given);
    behind = exports;
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
    behind = exports;
  }

  function makeDecoder(fields) {
    const given = read(fields);
    new Master(); // an instance of its own
    const memory = exports;
    const names = Object.keys(given.parameters);
    const texts = new TextEncoder().encode([given.codec, "", ...names].map((each) => `${each}\0`).join(""));
    new Uint8Array(memory.memory.buffer, memory.text(), texts.length).set(texts);
    const numbers = (count) => new Float64Array(memory.memory.buffer, memory.numbers(), count);
    const law = [given.weberFraction, given.floorN, given.multiplier];
    numbers(8 + names.length).set([...law, 0, given.axes, 0, 0, 0, ...Object.values(given.parameters)]);
    if (!memory.decoderInit(names.length)) throw new Error("there is no such decoder");
    decoder = {
      receive(data, nowUs) {
        new Uint8Array(memory.memory.buffer, memory.data(), data.length).set(data);
        return memory.decoderReceive(data.length, nowUs);
      },
      apply(positionM, nowUs) {
        numbers(given.axes).set(positionM);
        memory.decoderApply(nowUs);
        return Array.from(numbers(given.axes));
      },
      axes: given.axes,
    };
  }

  const vector = (fields, { axes } = node) => {
    if (fields.length !== axes) throw new Error(`there are ${fields.length} numbers for ${axes} axes`);
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
    decoder: makeDecoder,
    decode: ([now, data]) => String(Number(decoder.receive(fromHex(data), fromInt(now)))),
    apply: ([now, ...at]) => decoder.apply(vector(at, decoder), fromInt(now)).map(toFloat).join(" "),
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
      // Not of the suite: only this package tells it.
      granted: () => (node.granted ? Object.values(node.granted).map(Number).join(" ") : "-"),
      sequence: ([number]) => behind.masterNumber(fromInt(number)),
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

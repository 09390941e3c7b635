// What a program sees of the package; that its sessions are right is for the suite in peers/conformance.
import assert from "node:assert/strict";
import { EventEmitter } from "node:events";
import { test } from "node:test";
import {
  Master, Slave, formatKey, newKey, now, overChannel, overSocket, parseKey, parseKeyFile, publicKey, run, serve,
} from "../dist/index.js";

/** A spring of 300 N/m behind 10 mm. */
const spring = ([x]) => [x > 0.01 ? 300 * (x - 0.01) : 0];

/** Let a master touch a spring for some milliseconds in virtual time; return the forces that it felt. */
function touch(master, slave, milliseconds, lose = () => false) {
  const felt = [];
  for (let nowUs = 1000; nowUs <= 1000 * milliseconds; nowUs += 1000) {
    master.tick([0.02], nowUs);
    felt.push(master.force(nowUs)[0]);
    for (let data = master.send(); data; data = master.send()) {
      if (lose()) continue;
      const answer = slave.receive(data, "here", nowUs);
      if (answer) master.receive(answer, nowUs);
      if (!slave.position) continue;
      const force = slave.answer(spring(slave.position), nowUs);
      if (force && !lose()) master.receive(force, nowUs);
    }
  }
  return felt;
}

function keys() {
  const [ofMaster, ofSlave, psk] = [newKey(), newKey(), newKey()];
  return {
    master: { private: ofMaster, slave: publicKey(ofSlave), psk },
    slave: { private: ofSlave, masters: [{ public: publicKey(ofMaster), psk }] },
  };
}

test("a master feels the spring of a slave", () => {
  const [master, slave] = [new Master(), new Slave({ scene: "a spring" })];
  assert.ok(Math.abs(touch(master, slave, 200).at(-1) - 3) < 0.01);
  assert.equal(master.state, "established");
  assert.equal(master.scene, "a spring");
  assert.equal(slave.master, "here");
  assert.deepEqual(master.counts, { malformed: 0, stray: 0, tooOld: 0 });
});

test("a sealed session gives the same forces, and a listener nothing", () => {
  const { master, slave } = keys();
  const open = touch(new Master(), new Slave(), 200);
  const sealed = new Master({ keys: master });
  assert.deepEqual(touch(sealed, new Slave({ keys: slave }), 200), open);
  assert.equal(sealed.state, "established");
  const elsewhere = new Master({ keys: { ...master, slave: publicKey(newKey()) } });
  touch(elsewhere, new Slave({ keys: slave }), 200);
  assert.equal(elsewhere.state, "connecting");
});

test("a force without a sign of life is zero after 300 ms", () => {
  const [master, slave] = [new Master(), new Slave()];
  touch(master, slave, 200);
  assert.ok(master.force(330_000)[0] > 2.9);
  assert.deepEqual(master.force(510_000), [0]);
});

test("a slave knows its master by its address, however long", () => {
  const [master, slave] = [new Master(), new Slave()];
  assert.equal(slave.master, undefined);
  const address = "[2001:db8:0:0:0:0:0:1%a-long-interface]:47800";
  for (let nowUs = 0; nowUs < 20_000; nowUs += 1000) {
    master.tick([0], nowUs);
    for (let data = master.send(); data; data = master.send()) {
      const answer = slave.receive(data, address, nowUs);
      if (answer) master.receive(answer, nowUs);
    }
  }
  assert.equal(slave.master, address);
  slave.receive(new Uint8Array(9), "elsewhere", 30_000);
  assert.equal(slave.master, address);
  master.receive(slave.close("enough"), 30_000);
  assert.deepEqual(master.notice, { code: 0, text: "enough" });
  assert.equal(slave.close("again"), undefined);
});

test("a wrong datagram is dropped and counted, whatever it is and however long", () => {
  const [master, slave] = [new Master(), new Slave()];
  touch(master, slave, 50);
  for (const data of [new Uint8Array(), new Uint8Array(70_000), Buffer.from("hello")]) {
    master.receive(data, 60_000);
    assert.equal(slave.receive(data, "here", 60_000), undefined);
  }
  assert.equal(master.counts.malformed, 3);
  assert.equal(slave.counts.malformed, 3);
});

const WRONG = [
  [() => new Master({ codec: "lossless" }), /codec is 'lossless'; it must be one of raw, deadband, .*, model-mediated$/],
  [() => new Master({ axes: 4 }), /axes is 4; it must be 1 to 3/],
  [() => new Master({ axes: 2 ** 32 + 1 }), /axes is 4294967297; it must be 1 to 3/],
  [() => new Master({ axes: 1.5 }), /axes is 1.5; it must be 1 to 3/],
  [() => new Master({ rateHz: 5 }), /rateHz is 5; it must be between 20 and 100000$/],
  [() => new Master({ weberFraction: -1 }), /weberFraction is -1; it must be 0 or between 1e-12 and 1$/],
  [() => new Master({ positionShare: 1 }), /positionShare is 1; it must be 0 or between 0.01 and 0.9$/],
  [() => new Master({ parameters: { step_n: 3 } }), /step_n is 3; it must be 0 or between 1e-12 and 1$/],
  [() => new Master({ parameters: { step_n: 0, step: 3 } }), /parameter is 'step'; it must be one of deadband's: step_n$/],
  [() => new Master({ name: "x".repeat(65) }), /name is 'x{65}'; it must be at most 64 bytes of printable UTF-8$/],
  [() => new Master({ name: "x".repeat(2000) }), /the names have 2010 bytes; they must have at most 1,000$/],
  [() => new Slave({ scene: "a\nb" }), /scene is 'a\nb'; it must be at most 64 bytes of printable UTF-8$/],
  [() => new Master({ keys: { private: "abc", slave: "abc" } }), /keys.private has 3 characters that are no key/],
  [() => new Master({ keys: { private: newKey(), slave: new Uint8Array(32) } }), /keys.slave is not a public key/],
  [() => overSocket(new EventEmitter(), 47800, "localhost"), /address is 'localhost'; it must be numeric/],
  [() => overSocket(new EventEmitter(), 99999, "127.0.0.1"), /port is 99999; it must be 1 to 65535/],
  [() => new Slave({ axes: 0 }), /axes is 0; it must be 1 to 3/],
  [() => new Slave({ keys: { private: newKey(), masters: [{ public: "?" }] } }), /keys.masters\[0\].public has 1 char/],
  [() => new Master().tick([0, 0], 0), /positionM is \[0, 0\]; it must have 1 number$/],
  [() => new Master({ axes: 2 }).tick([0], 0), /positionM is \[0\]; it must have 2 numbers/],
  [() => new Master().tick([0], 0.5), /nowUs is 0.5; it must be a whole number of microseconds/],
  [() => new Slave().receive(new Uint8Array(1), "", 0), /address is empty/],
  [() => parseKey("a".repeat(44)), /the key has 44 characters that are no key; a key is 44 characters of base64/],
  [() => parseKeyFile('psk = "x"'), /psk has 1 characters/],
  [() => parseKeyFile("[master]"), /the key file has no line: private =/],
];

test("an error is one sentence that says what was wrong and what would be right", () => {
  for (const [call, sentence] of WRONG) assert.throws(call, { name: "RangeError", message: sentence });
});

test("a datagram that is no Uint8Array is an error", () => {
  assert.throws(() => new Master().receive(new ArrayBuffer(3), 0), { message: "the datagram must be a Uint8Array" });
});

test("an error does not show a key", () => {
  const own = newKey();
  const hidden = (call) =>
    assert.throws(call, ({ message }) => !message.includes(formatKey(own)) && !message.includes(formatKey(own).slice(1, 9)));
  hidden(() => new Master({ codec: "none", keys: { private: formatKey(own), slave: newKey() } }));
  hidden(() => new Master({ keys: { private: formatKey(own) + "=", slave: newKey() } }));
  hidden(() => new Master({ keys: { private: own, slave: publicKey(own) } }));
});

test("a key file of hapticnet is read", () => {
  const [own, psk] = [newKey(), newKey()];
  assert.deepEqual(parseKeyFile(`private = "${formatKey(own)}"\npsk = "${formatKey(psk)}"\n`), { private: own, psk });
  assert.deepEqual(parseKeyFile(`# mine\n  private="${formatKey(own)}" # secret`), { private: own });
});

/** Two transports, joined. */
function joined() {
  const [one, other] = [{ onmessage: null }, { onmessage: null }];
  one.send = (data) => setImmediate(() => other.onmessage?.(data, "one"));
  other.send = (data) => setImmediate(() => one.onmessage?.(data, "other"));
  return [one, other];
}

test("run and serve play a session over transports, and end it", async () => {
  const [here, there] = joined();
  const stop = serve(new Slave(), there, spring);
  const felt = [];
  const master = new Master({ rateHz: 200 });
  const signal = AbortSignal.timeout(500);
  await run(master, { transport: here, hand: () => [0.02], feel: ([force]) => felt.push(force), signal });
  assert.equal(master.state, "closed");
  assert.ok(Math.max(...felt) > 2.9);
  assert.equal(felt.at(-1), 0);
  stop();
});

test("a hand or a scene that fails ends the session, and its error is thrown", async () => {
  const [here, there] = joined();
  const stop = serve(new Slave(), there, spring);
  let left = 20;
  const hand = () => {
    if (left-- === 0) throw new Error("no hand");
    return [0];
  };
  const master = new Master({ rateHz: 200 });
  await assert.rejects(run(master, { transport: here, hand, feel: () => {} }), /no hand/);
  assert.notEqual(master.state, "established");
  stop();
});

test("a data channel loses what it cannot send at once", () => {
  const sent = [];
  const channel = {
    readyState: "connecting",
    bufferedAmount: 0,
    send: (data) => sent.push(new Uint8Array(data)),
    addEventListener: (_, listener) => (channel.hear = listener),
  };
  const transport = overChannel(channel);
  const heard = [];
  transport.onmessage = (data) => heard.push(data);
  transport.send(new Uint8Array([1]));
  channel.readyState = "open";
  transport.send(new Uint8Array([2]));
  channel.bufferedAmount = 5000;
  transport.send(new Uint8Array([3]));
  channel.hear({ data: new Uint8Array([4]).buffer });
  channel.hear({ data: "text" });
  assert.deepEqual([sent, heard], [[new Uint8Array([2])], [new Uint8Array([4])]]);
});

test("the clock gives whole microseconds", () => {
  assert.ok(Number.isInteger(now()));
  assert.ok(now() <= now());
});

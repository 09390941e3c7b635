import { Core, MOST_AXES, checkNow, checkVector, sayWrong, type Counts, type Random32 } from "./core.js";
import { shorten } from "./crypto.js";
import { checkPublic, parseKey, type Key } from "./keys.js";

/** A master that a slave serves. */
export interface Listed {
  /** The master's public key. */
  readonly public: Key;
  /** A key that both share, if there is one. */
  readonly psk?: Key;
}

/** What a slave serves, and whom. */
export interface SlaveOptions {
  /** What a master shows: at most 64 bytes. */
  readonly scene?: string;
  /** Components of a position, 1 to 3; 1 if omitted. */
  readonly axes?: number;
  /** The slave's private key and the masters that it serves. Without them it serves open sessions, to anyone. */
  readonly keys?: { readonly private: Key; readonly masters: readonly Listed[] };
  /** Source of 32 unpredictable bits, for tests; the system's if omitted. */
  readonly random32?: Random32;
}

const ADDRESS_BYTES = 28;

/**
 * The slave's end of a session with one master at a time: it gets positions, and answers forces.
 *
 * It does no input or output and reads no clock. Give it each datagram by `receive`. When all that has arrived was
 * received and `position` is not undefined, give `answer` the force there, and send what it returns to `master`.
 * The codecs are `deadband` and `raw`.
 */
export class Slave {
  /** Components of a position and of a force. */
  readonly axes: number;
  readonly #core: Core;
  #newest: { text: string; bytes: Uint8Array } = { text: "", bytes: new Uint8Array() };
  #master: string | undefined;

  /** Make a slave without a session; RangeError if an option is invalid. */
  constructor({ scene = "hapticnet.js", axes = 1, keys, random32 }: SlaveOptions = {}) {
    if (!Number.isInteger(axes) || axes < 1 || axes > MOST_AXES)
      throw new RangeError(`axes is ${axes}; it must be 1 to ${MOST_AXES}`);
    this.axes = axes;
    this.#core = new Core(random32);
    this.#core.putTexts([scene]);
    const wrong = this.#core.call.slaveInit(axes);
    if (wrong !== 0) throw new RangeError(sayWrong(this.#core.textAt(wrong), { scene }));
    if (keys === undefined) return;
    const listed = keys.masters.map(({ public: key, psk }, i) => {
      const bytes = new Uint8Array(64); // no shared key: zeros
      bytes.set(parseKey(key, `keys.masters[${i}].public`));
      checkPublic(bytes.slice(0, 32), `keys.masters[${i}].public`);
      if (psk !== undefined) bytes.set(parseKey(psk, `keys.masters[${i}].psk`), 32);
      return bytes;
    });
    this.#core.putKeys([parseKey(keys.private, "keys.private")]);
    const all = new Uint8Array(64 * listed.length);
    listed.forEach((bytes, i) => all.set(bytes, 64 * i));
    this.#core.call.slaveSeal(this.#core.keep(all), listed.length);
  }

  /**
   * Take in a datagram, whatever it contains.
   *
   * @param address - whom it came from, in any words: the same for the same sender
   * @returns an answer to that address, or undefined
   */
  receive(datagram: Uint8Array, address: string, nowUs: number): Uint8Array | undefined {
    checkNow(nowUs);
    if (address === "") throw new RangeError("address is empty; it must say whom the datagram came from");
    if (address !== this.#newest.text) this.#newest = { text: address, bytes: addressBytes(address) };
    this.#core.putAddress(this.#newest.bytes);
    const answered = this.#core.call.slaveReceive(this.#core.putDatagram(datagram), this.#newest.bytes.length, nowUs);
    const answer = this.#core.takeDatagram(answered);
    const size = this.#core.call.slaveMaster();
    if (String(this.#core.takeAddress(size)) === String(this.#newest.bytes)) this.#master = address;
    return answer;
  }

  /** Where the hand is [m], a number per axis, if its force is to be answered. */
  get position(): number[] | undefined {
    return this.#core.call.slavePosition() ? this.#core.takeNumbers(this.axes) : undefined;
  }

  /**
   * Give the force [N] at `position`; one that is not finite ends the session.
   *
   * @returns a datagram to `master`, or undefined if the master does not need this force
   */
  answer(forceN: readonly number[], nowUs: number): Uint8Array | undefined {
    checkNow(nowUs);
    checkVector("forceN", forceN, this.axes);
    this.#core.putNumbers(forceN);
    return this.#core.takeDatagram(this.#core.call.slaveAnswer(nowUs));
  }

  /** End the session; return a datagram to `master`, or undefined without a session. A reason has at most 200 bytes. */
  close(reason: string, code = 0): Uint8Array | undefined {
    this.#core.putReason(reason);
    return this.#core.takeDatagram(this.#core.call.slaveClose(code));
  }

  /** The address of the newest session's master; undefined before the first. */
  get master(): string | undefined {
    return this.#master;
  }

  get counts(): Counts {
    this.#core.call.slaveCounts();
    return this.#core.takeCounts();
  }
}

/** Return the bytes of an address; of a long one, a hash. */
function addressBytes(address: string): Uint8Array {
  const bytes = new TextEncoder().encode(address);
  return bytes.length < ADDRESS_BYTES ? bytes : shorten(bytes);
}

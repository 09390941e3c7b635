import { Core, MOST_AXES, checkNow, checkVector, sayWrong, type Counts, type Random32 } from "./core.js";
import { checkPublic, formatKey, parseKey, publicKey, type Key } from "./keys.js";

/** The keys that a master needs for a sealed session. */
export interface MasterKeys {
  /** The master's private key. */
  readonly private: Key;
  /** The slave's public key. */
  readonly slave: Key;
  /** A key that both share, if there is one. */
  readonly psk?: Key;
}

/** Who asks for a session, and how its forces are compressed. */
export interface MasterOptions {
  /** Codec of the forces; `"deadband"` if omitted. */
  readonly codec?: Codec;
  /** Parameters of the codec, by the names of the documentation. */
  readonly parameters?: Readonly<Record<string, number>>;
  /** What the slave's console calls this master: at most 64 bytes. */
  readonly name?: string;
  /** Components of a position, 1 to 3; 1 if omitted. */
  readonly axes?: number;
  /** Positions a second [Hz], 20 to 100,000; 1000 if omitted. */
  readonly rateHz?: number;
  /** Smallest change that the person feels, as a share of the force; 0.05 if omitted. */
  readonly weberFraction?: number;
  /** Smallest change that the person feels from no force [N]; 0.025 if omitted. */
  readonly floorN?: number;
  /** Width of the dead zone in just-noticeable differences; 1 if omitted. */
  readonly multiplier?: number;
  /**
   * Ask for few positions: one is sent only if the force could differ by more than this share of the just-noticeable
   * difference, 0.01 to 0.9. If omitted, every position is sent.
   */
  readonly positionShare?: number;
  /** Render contact that the slave announces, so that a surface is felt without the delay of the link. */
  readonly announced?: boolean;
  /** Let the slave answer the force where the hand will be when it arrives. */
  readonly predicted?: boolean;
  /** Keys of sealed sessions. Without them, sessions are open: anyone on the path can read and forge them. */
  readonly keys?: MasterKeys;
  /** Source of 32 unpredictable bits, for tests; the system's if omitted. */
  readonly random32?: Random32;
}

/** A codec that this master can ask for. */
export type Codec =
  | "raw"
  | "deadband"
  | "adaptive-predictive"
  | "motion-predictive"
  | "linear-predictive"
  | "least-squares"
  | "level-crossing"
  | "velocity-adaptive"
  | "passive-extrapolative"
  | "passive-interpolative"
  | "probabilistic"
  | "merging"
  | "model-mediated";

/** What a master does: asks, has a session, has one that is silent, ends it, has ended. */
export type MasterState = "connecting" | "established" | "stale" | "closing" | "closed";

const STATES: readonly MasterState[] = ["connecting", "established", "stale", "closing", "closed"];

/** A reason that the slave gave: of a refusal, an end or a notice. */
export interface Notice {
  /** Code of the protocol. */
  readonly code: number;
  /** The slave's words. */
  readonly text: string;
}

/** What the slave granted of that which may be asked for. */
export interface Granted {
  /** Few positions are sent; without it, every one. */
  readonly fewPositions: boolean;
  /** The slave answers the force where the hand will be. */
  readonly predicted: boolean;
  /** The slave announces contact. */
  readonly announced: boolean;
}

/**
 * The master's end of a session: it sends where the hand is, and gives the force that the hand feels.
 *
 * It does no input or output and reads no clock. `rateHz` times a second, call `tick`, `force` and then `send` until it
 * returns undefined; give it each datagram that arrives by `receive`, and call `send` after that, too. `run` does all of
 * this over a transport.
 */
export class Master {
  /** Components of a position and of a force. */
  readonly axes: number;
  /** Positions a second [Hz]. */
  readonly rateHz: number;
  readonly #core: Core;

  /** Start to ask for a session; RangeError if an option is invalid. */
  constructor(options: MasterOptions = {}) {
    const { codec = "deadband", name = "hapticnet.js", axes = 1, rateHz = 1000, parameters = {} } = options;
    const { weberFraction = 0.05, floorN = 0.025, multiplier = 1 } = options;
    const { positionShare = 0, announced = false, predicted = false } = options;
    const named = Object.entries(parameters);
    if (named.length > 5) throw new RangeError(`parameters has ${named.length} entries; a codec has at most 5`);
    if (!Number.isInteger(axes) || axes < 1 || axes > MOST_AXES) throw new RangeError(`axes is ${axes}; it must be 1 to ${MOST_AXES}`);
    this.axes = axes;
    this.rateHz = rateHz;
    this.#core = new Core(options.random32);
    this.#core.putTexts([codec, name, ...named.map(([key]) => key)]);
    const law = [weberFraction, floorN, multiplier, rateHz, axes, positionShare, Number(announced), Number(predicted)];
    this.#core.putNumbers([...law, ...named.map(([, value]) => value)]);
    const wrong = this.#core.call.masterInit(named.length);
    if (wrong !== 0) {
      const sentence = this.#core.textAt(wrong);
      const parameter = Object.keys(parameters).find((key) => !sentence.split(/[ ,]+/).includes(key));
      throw new RangeError(sayWrong(sentence, { ...parameters, ...options, parameter }));
    }
    if (options.keys !== undefined) this.#seal(options.keys);
  }

  #seal({ private: own, slave, psk }: MasterKeys): void {
    const keys = [parseKey(own, "keys.private"), parseKey(slave, "keys.slave")] as const;
    checkPublic(keys[1], "keys.slave");
    if (formatKey(publicKey(keys[0])) === formatKey(keys[1]))
      throw new RangeError("keys.slave is the master's own public key; 'hapticnet key public' prints the slave's on its host");
    this.#core.putKeys(psk === undefined ? keys : [...keys, parseKey(psk, "keys.psk")]);
    this.#core.call.masterSeal(psk !== undefined);
  }

  /**
   * Do what is due in this period.
   *
   * @param positionM - where the hand is [m], a number per axis; undefined if that is not known: no position is sent
   * @param nowUs - the time [µs], a whole number that grows
   */
  tick(positionM: readonly number[] | undefined, nowUs: number): void {
    checkNow(nowUs);
    if (positionM !== undefined) {
      checkVector("positionM", positionM, this.axes);
      this.#core.putNumbers(positionM);
    }
    this.#core.call.masterTick(nowUs, positionM !== undefined);
  }

  /** Return the force that the hand feels now [N], a number per axis. Apply no more than a device and a hand can bear. */
  force(nowUs: number): number[] {
    checkNow(nowUs);
    this.#core.call.masterForce(nowUs);
    return this.#core.takeNumbers(this.axes);
  }

  /** Return a datagram to send; undefined if there is none. */
  send(): Uint8Array | undefined {
    return this.#core.takeDatagram(this.#core.call.masterSend());
  }

  /** Take in a datagram, whatever it contains: one that is wrong is counted and dropped. */
  receive(datagram: Uint8Array, nowUs: number): void {
    checkNow(nowUs);
    this.#core.call.masterReceive(this.#core.putDatagram(datagram), nowUs);
  }

  /** End the session; then go on until the state is `"closed"`. A reason has at most 200 bytes. */
  close(reason: string, nowUs: number): void {
    checkNow(nowUs);
    this.#core.putReason(reason);
    this.#core.call.masterClose(nowUs);
  }

  get state(): MasterState {
    return STATES[this.#core.call.masterState()] as MasterState;
  }

  /** The newest reason that the slave gave for a refusal or an end, or its newest notice; undefined without one. */
  get notice(): Notice | undefined {
    const text = this.#core.textAt(this.#core.call.masterReason());
    const code = this.#core.call.masterCode();
    return text === "" && code === 0 ? undefined : { code, text };
  }

  /** What the slave calls its scene; empty before the first session. */
  get scene(): string {
    return this.#core.textAt(this.#core.call.masterScene());
  }

  /** What the slave granted for the newest session; undefined before the first. */
  get granted(): Granted | undefined {
    const bits = this.#core.call.masterGranted();
    return bits < 0 ? undefined : { fewPositions: !!(bits & 1), predicted: !!(bits & 2), announced: !!(bits & 4) };
  }

  get counts(): Counts {
    this.#core.call.masterCounts();
    return this.#core.takeCounts();
  }
}

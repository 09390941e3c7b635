/** The C library as WebAssembly: each master or slave is an instance of its own. */
import packed from "../build/hapticnet.wasm.txt";
import { primitives } from "./crypto.js";

/** Largest datagram of the protocol [bytes]. @internal */
export const DATAGRAM_BYTES = 1200;
/** Most axes of a position. @internal */
export const MOST_AXES = 3;
const TEXT_BYTES = 1024;
const KEY_BYTES = 32;
const PAGE_BYTES = 65536;

/** What `bridge.c` exports. @internal */
interface Exports {
  memory: WebAssembly.Memory;
  data(): number;
  answer(): number;
  text(): number;
  numbers(): number;
  address(): number;
  keys(): number;
  counts(): number;
  masterInit(parameters: number): number;
  masterSeal(hasPsk: boolean): number;
  masterTick(nowUs: number, hasPosition: boolean): void;
  masterForce(nowUs: number): void;
  masterSend(): number;
  masterReceive(size: number, nowUs: number): void;
  masterClose(nowUs: number): void;
  masterState(): number;
  masterScene(): number;
  masterReason(): number;
  masterCode(): number;
  masterGranted(): number;
  masterCounts(): void;
  slaveInit(axes: number): number;
  slaveSeal(listed: number, count: number): number;
  slaveReceive(size: number, addressSize: number, nowUs: number): number;
  slavePosition(): number;
  slaveAnswer(nowUs: number): number;
  slaveClose(code: number): number;
  slaveMaster(): number;
  slaveCounts(): void;
}

/** Returns 32 unpredictable bits. */
export type Random32 = () => number;

/** Datagrams that a peer dropped, and answers that came too late to count. */
export interface Counts {
  readonly malformed: number;
  readonly stray: number;
  readonly tooOld: number;
}

/** Read what `build.mjs` wrote in base 85. */
function unpack(text: string): ArrayBuffer {
  const bytes = new DataView(new ArrayBuffer(((text.length - 1) / 5) * 4));
  for (let i = 0; i < bytes.byteLength; i += 4) {
    let number = 0;
    for (let at = 1 + (i / 4) * 5, end = at + 5; at < end; at++) {
      const code = text.charCodeAt(at);
      number = 85 * number + code - (code > 92 ? 36 : 35);
    }
    bytes.setUint32(i, number);
  }
  return bytes.buffer.slice(0, bytes.byteLength - Number(text[0]));
}

async function compile(): Promise<WebAssembly.Module> {
  const stream = new Blob([unpack(packed)]).stream().pipeThrough(new DecompressionStream("deflate"));
  return WebAssembly.compile(await new Response(stream).arrayBuffer());
}

const library = await compile();

function systemRandom32(): number {
  return crypto.getRandomValues(new Uint32Array(1))[0] as number;
}

/** An instance of the library, and what passes between it and TypeScript. @internal */
export class Core {
  readonly call: Exports;
  readonly #bytes: (at: number, size: number) => Uint8Array;

  constructor(random32: Random32 = systemRandom32) {
    this.#bytes = (at, size) => new Uint8Array(this.call.memory.buffer, at, size);
    const { pow, expm1, log1p } = Math;
    const host = { hn_host_pow: pow, hn_host_expm1: expm1, hn_host_log1p: log1p };
    const env = { random32: () => random32() | 0, ...host, ...primitives(this.#bytes) };
    this.call = new WebAssembly.Instance(library, { env }).exports as unknown as Exports;
  }

  /** Give the library a datagram; return its size. One that is too long is cut, so that it is dropped and counted. */
  putDatagram(data: Uint8Array): number {
    if (!(data instanceof Uint8Array)) throw new TypeError("the datagram must be a Uint8Array");
    const size = Math.min(data.length, DATAGRAM_BYTES + 1);
    this.#bytes(this.call.data(), size).set(data.subarray(0, size));
    return size;
  }

  /** Copy the datagram of `size` bytes that the library made; undefined if it made none. */
  takeDatagram(size: number): Uint8Array | undefined {
    return size > 0 ? this.#bytes(this.call.answer(), size).slice() : undefined;
  }

  /** Give the library texts that stay; RangeError if they are too long. */
  putTexts(texts: readonly string[]): void {
    const bytes = new TextEncoder().encode(texts.map((each) => each.replaceAll("\0", "") + "\0").join(""));
    if (bytes.length > TEXT_BYTES) throw new RangeError(`the names have ${bytes.length} bytes; they must have at most 1,000`);
    this.#bytes(this.call.text(), bytes.length).set(bytes);
  }

  /** Give the library a reason for an end. */
  putReason(reason: string): void {
    const at = this.#bytes(this.call.data(), DATAGRAM_BYTES);
    at[new TextEncoder().encodeInto(reason, at.subarray(0, -1)).written] = 0;
  }

  putNumbers(numbers: readonly number[]): void {
    new Float64Array(this.call.memory.buffer, this.call.numbers(), numbers.length).set(numbers);
  }

  takeNumbers(count: number): number[] {
    return Array.from(new Float64Array(this.call.memory.buffer, this.call.numbers(), count));
  }

  putKeys(keys: readonly Uint8Array[]): void {
    keys.forEach((key, i) => this.#bytes(this.call.keys() + KEY_BYTES * i, KEY_BYTES).set(key));
  }

  putAddress(address: Uint8Array): void {
    this.#bytes(this.call.address(), address.length).set(address);
  }

  takeAddress(size: number): Uint8Array {
    return this.#bytes(this.call.address(), size).slice();
  }

  /** Give the library bytes that stay, in memory of their own; return where they are. */
  keep(bytes: Uint8Array): number {
    const at = PAGE_BYTES * this.call.memory.grow(Math.ceil(bytes.length / PAGE_BYTES));
    this.#bytes(at, bytes.length).set(bytes);
    return at;
  }

  /** Read a text of the library, which ends with a zero. */
  textAt(at: number): string {
    const bytes = new Uint8Array(this.call.memory.buffer, at);
    return new TextDecoder().decode(bytes.subarray(0, bytes.indexOf(0)));
  }

  takeCounts(): Counts {
    const [malformed, stray, tooOld] = new Uint32Array(this.call.memory.buffer, this.call.counts(), 3);
    return { malformed, stray, tooOld } as Counts;
  }
}

/**
 * Say what the library says is wrong, "rate_hz must be ...", with the option's value: "rateHz is 5; it must be ...".
 *
 * @param values - the options by their names, and the codec's parameters by theirs
 * @internal
 */
export function sayWrong(wrong: string, values: Readonly<Record<string, unknown>>): string {
  const [field = "", right] = wrong.split(" must be ");
  const name = field in values ? field : field.replace(/_./g, (each) => each.charAt(1).toUpperCase());
  const value = values[name];
  return `${name} is ${typeof value === "string" ? `'${value}'` : value}; it must be ${right}`;
}

/** Check a time; RangeError unless it is a whole number of microseconds. @internal */
export function checkNow(nowUs: number): void {
  if (!Number.isSafeInteger(nowUs))
    throw new RangeError(`nowUs is ${nowUs}; it must be a whole number of microseconds, such as now() gives`);
}

/** Check a vector; RangeError unless it has a number for each axis. @internal */
export function checkVector(name: string, vector: readonly number[], axes: number): void {
  if (vector.length !== axes || !vector.every((each) => typeof each === "number"))
    throw new RangeError(`${name} is [${vector.join(", ")}]; it must have ${axes} ${axes === 1 ? "number" : "numbers"}`);
}

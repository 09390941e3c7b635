import type { Master, Notice } from "./master.js";
import type { Slave } from "./slave.js";

/** As timers are late by a tenth of a millisecond or more, a tick may come early by this share of a period. */
const EARLY = 0.3;

/** What carries a master's datagrams: a UDP socket, a data channel. It may lose, delay and reorder them. */
export interface Transport {
  /** Send a datagram, or lose it; it must not throw. */
  send(datagram: Uint8Array): void;
  /** Called with each datagram that arrives. */
  onmessage: ((datagram: Uint8Array) => void) | null;
}

/** What a master is run with. */
export interface RunOptions {
  readonly transport: Transport;
  /** Say where the hand is [m], a number per axis; undefined if that is not known. Called once a period. */
  readonly hand: (nowUs: number) => readonly number[] | undefined;
  /** Apply the force [N], a number per axis. Called once a period, and with zeros at the end. */
  readonly feel: (forceN: number[], nowUs: number) => void;
  /** Ends the session when it is aborted. */
  readonly signal?: AbortSignal;
  /** Wait some time [ms]; by a timer if omitted. A hidden tab keeps its pace only by the timers of a worker. */
  readonly sleep?: (ms: number) => Promise<void>;
}

/** Return the time [µs] of a clock that never goes back. */
export function now(): number {
  return Math.floor(performance.now() * 1000);
}

/**
 * Run a master until its session has ended: each period it asks for the hand's place, and gives the force.
 *
 * @returns why the session ended, if the slave said so
 * @throws what `hand` or `feel` throws, after the session was closed
 */
export async function run(master: Master, options: RunOptions): Promise<Notice | undefined> {
  const { transport, hand, feel, signal, sleep: wake = sleeper() } = options;
  const periodUs = 1e6 / master.rateHz;
  const flush = () => {
    for (let data = master.send(); data !== undefined; data = master.send()) transport.send(data);
  };
  transport.onmessage = (data) => {
    master.receive(data, now());
    flush();
  };
  try {
    for (let dueUs = now(); master.state !== "closed"; ) {
      if (signal?.aborted) master.close("stopped", now());
      master.tick(hand(now()), now());
      feel(master.force(now()), now());
      flush();
      dueUs = Math.max(dueUs + periodUs, now()); // missed periods are not made up for
      while (now() < dueUs - EARLY * periodUs) await wake((dueUs - now()) / 1000);
    }
    return master.notice;
  } catch (error) {
    master.close("the hand failed", now());
    flush();
    throw error;
  } finally {
    transport.onmessage = null;
    feel(new Array<number>(master.axes).fill(0), now());
  }
}

/** What carries a slave's datagrams: a `Transport`, or one that knows addresses. */
export interface SlaveTransport {
  /** Send a datagram to an address that a datagram came from, or lose it; it must not throw. */
  send(datagram: Uint8Array, address: string): void;
  /** Called with each datagram that arrives, and whom it came from, if there are several. */
  onmessage: ((datagram: Uint8Array, address?: string) => void) | null;
}

/**
 * Serve masters over a transport: each position is answered with the force that `touch` gives there.
 *
 * @param touch - gives the force [N] at a position [m], a number per axis; if it throws, the session ends
 * @returns a function that ends the session and stops
 */
export function serve(
  slave: Slave,
  transport: SlaveTransport,
  touch: (positionM: number[]) => readonly number[],
): (reason?: string) => void {
  const send = (data: Uint8Array | undefined, address: string | undefined) => {
    if (data !== undefined && address !== undefined) transport.send(data, address);
  };
  transport.onmessage = (data, address = "peer") => {
    send(slave.receive(data, address, now()), address);
    const positionM = slave.position;
    if (positionM === undefined) return;
    try {
      send(slave.answer(touch(positionM), now()), slave.master);
    } catch (error) {
      send(slave.close("the scene failed", 6), slave.master);
      throw error;
    }
  };
  return (reason = "stopped") => {
    send(slave.close(reason), slave.master);
    transport.onmessage = null;
  };
}

/**
 * Make a function that waits some time [ms].
 *
 * Browsers make a timer wait at least 4 ms if a timer started it, and that one was started by a timer, five times. A
 * message between the timers ends this chain, so that a period of 1 ms is kept without a loop that is always busy.
 */
function sleeper(): (ms: number) => Promise<void> {
  const { port1, port2 } = new MessageChannel();
  return (ms) =>
    new Promise((resolve) => {
      port1.onmessage = () => {
        port1.onmessage = null; // Node ends although the channel is open
        resolve();
      };
      setTimeout(() => port2.postMessage(0), ms);
    });
}

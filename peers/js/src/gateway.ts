/**
 * A transport through `hapticnet gateway`, for tabs: a WebRTC data channel, made again when it is lost.
 *
 * @packageDocumentation
 */
import type { Transport } from "./run.js";

/** As much as the channel may hold back [bytes]: what waits longer than a moment comes too late. */
const MOST_HELD_BACK = 128;

const FIRST_RETRY_MS = 500;
const LONGEST_RETRY_MS = 5000;
const ANSWER_WITHIN_MS = 10_000;
const OPEN_WITHIN_MS = 8000;
/** Silence after which a connection that has carried something counts as lost. A slave sends twenty times a second. */
const SILENCE_MS = 2000;
const CHECK_MS = 250;
/** Statuses that no later try would change. */
const FINAL: readonly number[] = [400, 401, 403, 404, 421];

/** What a link does: connects, carries datagrams, waits to try again, was refused for good, was closed. */
export type LinkState = "connecting" | "open" | "waiting" | "refused" | "closed";

/** Where the gateway is, and what lets a tab in. */
export interface GatewayOptions {
  /** Address of the gateway, such as `https://touch.example`. */
  readonly url: string;
  /** Its token. */
  readonly token: string;
  /** Called when the state changes, with a sentence for a person. */
  readonly onstate?: (state: LinkState, reason: string) => void;
}

/** What was carried. */
export interface Carried {
  sent: number;
  sentBytes: number;
  received: number;
  receivedBytes: number;
  /** Datagrams that were not sent, because the channel was not open or held too much back. */
  dropped: number;
  /** Connections so far. */
  connections: number;
}

interface Attempt {
  readonly connection: RTCPeerConnection;
  readonly channel: RTCDataChannel;
  readonly begunMs: number;
  heardMs: number | undefined;
}

/** Carry a master's datagrams through a gateway; the session goes on over each new connection. */
export class GatewayLink implements Transport {
  onmessage: ((datagram: Uint8Array) => void) | null = null;
  readonly carried: Carried = { sent: 0, sentBytes: 0, received: 0, receivedBytes: 0, dropped: 0, connections: 0 };
  #state: LinkState = "connecting";
  #open: Attempt | undefined;
  #next: Attempt | undefined;
  #retryMs = FIRST_RETRY_MS;
  #retry: ReturnType<typeof setTimeout> | undefined;
  readonly #options: GatewayOptions;
  readonly #timer: ReturnType<typeof setInterval>;
  readonly #left = new AbortController();

  /** Begin to connect. */
  constructor(options: GatewayOptions) {
    this.#options = options;
    this.#timer = setInterval(() => this.#check(), CHECK_MS);
    const again = () => this.reconnect("the network has changed");
    const { signal } = this.#left;
    globalThis.addEventListener?.("online", again, { signal });
    const network = (navigator as { connection?: EventTarget }).connection;
    network?.addEventListener("change", again, { signal });
    void this.#connect();
  }

  get state(): LinkState {
    return this.#state;
  }

  send(datagram: Uint8Array): void {
    const channel = this.#open?.channel;
    if (channel?.readyState !== "open" || channel.bufferedAmount > MOST_HELD_BACK) {
      this.carried.dropped++;
      return;
    }
    this.carried.sent++;
    this.carried.sentBytes += datagram.length;
    channel.send(datagram as Uint8Array<ArrayBuffer>);
  }

  /** Make a new connection now; the present one carries on until that is open. */
  reconnect(reason: string): void {
    if (this.#state === "closed" || this.#next !== undefined) return;
    clearTimeout(this.#retry);
    this.#retryMs = FIRST_RETRY_MS;
    this.#say("connecting", reason);
    void this.#connect();
  }

  /** Return the round trip to the gateway [ms] and the bytes of both directions with all headers; undefined if not known. */
  async stats(): Promise<{ roundTripMs: number | undefined; bytes: number } | undefined> {
    const report = await this.#open?.connection.getStats();
    for (const entry of report?.values() ?? []) {
      if (entry.type !== "candidate-pair" || !entry.nominated) continue;
      const { currentRoundTripTime: trip, bytesSent, bytesReceived } = entry;
      const headers = 28 * ((entry.packetsSent ?? 0) + (entry.packetsReceived ?? 0));
      return { roundTripMs: trip === undefined ? undefined : 1000 * trip, bytes: bytesSent + bytesReceived + headers };
    }
    return undefined;
  }

  close(): void {
    this.#say("closed", "closed");
    clearInterval(this.#timer);
    clearTimeout(this.#retry);
    this.#left.abort();
    for (const attempt of [this.#open, this.#next]) end(attempt);
    this.#open = this.#next = undefined;
  }

  async #connect(): Promise<void> {
    const connection = new RTCPeerConnection();
    const channel = connection.createDataChannel("hapticnet", { ordered: false, maxRetransmits: 0 });
    const attempt: Attempt = { connection, channel, begunMs: performance.now(), heardMs: undefined };
    this.#next = attempt;
    channel.binaryType = "arraybuffer";
    channel.onmessage = ({ data }) => this.#receive(attempt, data);
    channel.onopen = () => this.#opened(attempt);
    channel.onclose = () => this.#lost(attempt, "the gateway has closed the connection");
    connection.onconnectionstatechange = () => {
      if (connection.connectionState === "failed") this.#lost(attempt, "the connection has failed");
      else if (connection.connectionState === "disconnected") this.reconnect("the connection is interrupted");
    };
    try {
      await connection.setLocalDescription();
      const { url, token } = this.#options;
      const answer = await fetch(new URL("offer", url), {
        method: "POST",
        headers: { Authorization: `Bearer ${token}`, "Content-Type": "application/sdp" },
        body: connection.localDescription?.sdp ?? "",
        credentials: "omit",
        cache: "no-store",
        signal: AbortSignal.timeout(ANSWER_WITHIN_MS),
      });
      const text = await answer.text();
      if (answer.status !== 201) {
        this.#lost(attempt, text.trim() || `the gateway answers ${answer.status}`, FINAL.includes(answer.status));
        return;
      }
      if (this.#next === attempt) await connection.setRemoteDescription({ type: "answer", sdp: text });
    } catch {
      this.#lost(attempt, "the gateway does not answer");
    }
  }

  #opened(attempt: Attempt): void {
    if (this.#next !== attempt) return;
    end(this.#open);
    this.#open = attempt;
    this.#next = undefined;
    this.#retryMs = FIRST_RETRY_MS;
    this.carried.connections++;
    this.#say("open", "connected to the gateway");
  }

  #receive(attempt: Attempt, data: unknown): void {
    if (!(data instanceof ArrayBuffer) || (attempt !== this.#open && attempt !== this.#next)) return;
    attempt.heardMs = performance.now();
    this.carried.received++;
    this.carried.receivedBytes += data.byteLength;
    this.onmessage?.(new Uint8Array(data));
  }

  #lost(attempt: Attempt, reason: string, final = false): void {
    const isOpen = attempt === this.#open;
    if (!isOpen && attempt !== this.#next) return;
    end(attempt);
    if (isOpen) this.#open = undefined;
    else this.#next = undefined;
    if (final) {
      this.#say("refused", reason);
    } else if (this.#next === undefined) {
      if (this.#open === undefined) this.#say("waiting", reason);
      clearTimeout(this.#retry);
      this.#retry = setTimeout(() => void this.#connect(), this.#retryMs);
      this.#retryMs = Math.min(2 * this.#retryMs, LONGEST_RETRY_MS);
    }
  }

  #check(): void {
    const nowMs = performance.now();
    if (this.#next !== undefined && nowMs - this.#next.begunMs > OPEN_WITHIN_MS + ANSWER_WITHIN_MS)
      this.#lost(this.#next, "no datagram passes between this tab and the gateway");
    const heardMs = this.#open?.heardMs;
    if (heardMs !== undefined && nowMs - heardMs > SILENCE_MS && this.#open !== undefined) {
      this.#open.heardMs = undefined; // once: the slave may be the one that is silent
      this.reconnect("nothing arrives");
    }
  }

  #say(state: LinkState, reason: string): void {
    this.#state = state;
    this.#options.onstate?.(state, reason);
  }
}

function end(attempt: Attempt | undefined): void {
  if (attempt === undefined) return;
  attempt.channel.onclose = attempt.connection.onconnectionstatechange = null;
  attempt.channel.close();
  attempt.connection.close();
}

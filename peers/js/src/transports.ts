import type { SlaveTransport, Transport } from "./run.js";

/** As much as a data channel may hold back [bytes]; what is sent beyond is lost, because it would come too late. */
const MOST_HELD_BACK = 4096;

/** What `overChannel` uses of an `RTCDataChannel`. */
export interface Channel {
  binaryType: string;
  readonly readyState: string;
  readonly bufferedAmount: number;
  send(data: ArrayBuffer): void;
  addEventListener(kind: "message", listener: (event: { data: unknown }) => void): void;
}

/** Carry datagrams by a WebRTC data channel; open it with `{ ordered: false, maxRetransmits: 0 }`. */
export function overChannel(channel: Channel): Transport {
  const transport: Transport = {
    onmessage: null,
    send(data) {
      if (channel.readyState === "open" && channel.bufferedAmount < MOST_HELD_BACK)
        channel.send(data.slice().buffer as ArrayBuffer);
    },
  };
  channel.binaryType = "arraybuffer";
  channel.addEventListener("message", ({ data }) => {
    if (data instanceof ArrayBuffer) transport.onmessage?.(new Uint8Array(data));
  });
  return transport;
}

/** What `overSocket` uses of a socket of Node's `dgram`. */
export interface Socket {
  send(data: Uint8Array, port: number, address: string, done: () => void): void;
  on(event: "message", listener: (data: Uint8Array, from: { address: string; port: number }) => void): unknown;
  on(event: "error", listener: (error: Error) => void): unknown;
}

/**
 * Carry datagrams to and from one address by a UDP socket of Node; those from elsewhere are dropped.
 *
 * @throws RangeError if the address is a name, which no datagram comes from, or the port is wrong
 */
export function overSocket(socket: Socket, port: number, address: string): Transport {
  if (!/^[\d.]+$|:/.test(address)) throw new RangeError(`address is '${address}'; it must be numeric, as 127.0.0.1`);
  if (!(port >= 1 && port <= 65535)) throw new RangeError(`port is ${port}; it must be 1 to 65535`);
  const transport: Transport = { onmessage: null, send: (data) => socket.send(data, port, address, ignore) };
  socket.on("message", (data, from) => {
    if (from.port === port && from.address === address) transport.onmessage?.(data);
  });
  socket.on("error", ignore);
  return transport;
}

/** Carry a slave's datagrams by a UDP socket of Node that is bound. */
export function onSocket(socket: Socket): SlaveTransport {
  const transport: SlaveTransport = {
    onmessage: null,
    send(data, to) {
      const [port, address] = to.split(" ", 2) as [string, string];
      socket.send(data, Number(port), address, ignore);
    },
  };
  socket.on("message", (data, from) => transport.onmessage?.(data, `${from.port} ${from.address}`));
  socket.on("error", ignore);
  return transport;
}

/** Do nothing: a datagram that cannot be sent is lost, and the session deals with losses. */
function ignore(): void {}

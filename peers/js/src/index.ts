/**
 * Both ends of the hapticnet protocol: force feedback over a network, in browsers and Node.
 *
 * @packageDocumentation
 */
export { Master } from "./master.js";
export type { Codec, Granted, MasterKeys, MasterOptions, MasterState, Notice } from "./master.js";
export { Slave } from "./slave.js";
export type { Listed, SlaveOptions } from "./slave.js";
export { now, run, serve } from "./run.js";
export type { RunOptions, SlaveTransport, Transport } from "./run.js";
export { onSocket, overChannel, overSocket } from "./transports.js";
export type { Channel, Socket } from "./transports.js";
export { formatKey, newKey, parseKey, parseKeyFile, publicKey } from "./keys.js";
export type { Key, KeyFile } from "./keys.js";
export type { Counts, Random32 } from "./core.js";

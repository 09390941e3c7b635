// The WebSocket: opens it, opens it again when it is lost, and gives messages to a handler.

import { decode } from "./wire.js";

const FIRST_RETRY_MS = 500;
const LONGEST_RETRY_MS = 5000;
const OWN_CODES_FROM = 4000; // the server's own codes: it has said why, and trying again would not help

export class Connection {
  /**
   * @param {string} view "watch" or "operator"
   * @param {object} on `open()`, `closed({final, reason, retryMs})`, `message(object)`
   * @param {function} read returns the message in an ArrayBuffer, or null
   */
  constructor(view, on, read = decode) {
    const address = new URL(`socket/${view}`, location.href);
    address.protocol = location.protocol === "https:" ? "wss:" : "ws:";
    address.search = location.search;
    this._address = address.href;
    this._on = on;
    this._read = read;
    this._retryMs = FIRST_RETRY_MS;
    this._socket = null;
    this._open();
  }

  get isOpen() {
    return this._socket?.readyState === WebSocket.OPEN;
  }

  sendBinary(buffer) {
    if (this.isOpen) this._socket.send(buffer);
  }

  send(type, content = {}) {
    if (this.isOpen) this._socket.send(JSON.stringify({ type, ...content }));
  }

  /** Try again now, after the server had refused or ended. */
  retry() {
    this._retryMs = FIRST_RETRY_MS;
    this._open();
  }

  _open() {
    const socket = new WebSocket(this._address);
    socket.binaryType = "arraybuffer";
    socket.onopen = () => {
      this._retryMs = FIRST_RETRY_MS;
      this._on.open();
    };
    socket.onmessage = ({ data }) => {
      const message = typeof data === "string" ? parse(data) : this._read(data);
      if (message) this._on.message(message);
    };
    socket.onclose = ({ code, reason }) => {
      const final = code >= OWN_CODES_FROM;
      this._on.closed({ final, reason, retryMs: this._retryMs });
      if (final) return;
      setTimeout(() => this._open(), this._retryMs);
      this._retryMs = Math.min(2 * this._retryMs, LONGEST_RETRY_MS);
    };
    this._socket = socket;
  }
}

function parse(text) {
  try {
    const message = JSON.parse(text);
    return typeof message?.type === "string" ? { ...message, kind: message.type } : null;
  } catch {
    return null;
  }
}

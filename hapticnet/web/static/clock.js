// The server's time as a smooth function of the page's, so that the plot does not jump with each message.

const LATE_S = 0.035; // shown that late, so that the newest sample is there before its time comes
const SETTLE_S = 0.5; // time constant of the correction
const JUMP_S = 0.5; // a larger error is a pause or a new server, and is taken over at once

export class Clock {
  constructor() {
    this._offset = null;
    this._updated = 0;
  }

  /** Note that a sample of server time `serverS` was the newest at page time `pageS`. */
  observe(serverS, pageS) {
    const offset = serverS - pageS;
    if (this._offset === null || Math.abs(offset - this._offset) > JUMP_S) this._offset = offset;
    else this._offset += (offset - this._offset) * Math.min(1, (pageS - this._updated) / SETTLE_S);
    this._updated = pageS;
  }

  /** Server time [s] to show at page time `pageS`; NaN before the first sample. It stops 0.1 s after the last one. */
  now(pageS) {
    return this._offset === null ? NaN : Math.min(pageS, this._updated + 0.1) + this._offset - LATE_S;
  }

  reset() {
    this._offset = null;
  }
}

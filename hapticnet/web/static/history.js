// The newest samples, column by column, in typed arrays. Nothing is allocated after the start.

export class History {
  /**
   * @param {string[]} names columns to keep; `time` (seconds, double precision) is kept besides
   * @param {number} rows rows that are always available once they have arrived
   */
  constructor(names, rows) {
    this.names = names;
    this.rows = rows;
    this.length = 0;
    this.missed = 0; // rows that the server left out for this page
    this._nextRow = null;
    // Twice the rows: the newest half is moved to the front only when the arrays are full.
    this._time = new Float64Array(2 * rows);
    this._columns = new Map(names.map((name) => [name, new Float32Array(2 * rows)]));
  }

  /** Append a SAMPLES message; `order` holds the names of its columns. Ignores columns that are not kept. */
  append(message, order) {
    const count = Math.min(message.rows, this.rows);
    const skip = message.rows - count;
    if (this._nextRow !== null) this.missed += (message.firstRow - this._nextRow) >>> 0;
    this._nextRow = (message.firstRow + message.rows) >>> 0;
    if (this.length + count > 2 * this.rows) this._compact();
    const since = message.columns[order.indexOf("t")];
    for (let row = 0; row < count; row += 1) this._time[this.length + row] = message.startS + since[skip + row];
    for (const [name, column] of this._columns) {
      const index = order.indexOf(name);
      if (index < 0) column.fill(NaN, this.length, this.length + count);
      else column.set(message.columns[index].subarray(skip), this.length);
    }
    this.length += count;
  }

  /** Forget everything, for a new connection. */
  clear() {
    this.length = 0;
    this._nextRow = null;
  }

  get firstKept() {
    return Math.max(0, this.length - this.rows);
  }

  /** Times [s], oldest first. A view: valid until the next `append`. */
  get time() {
    return this._time.subarray(this.firstKept, this.length);
  }

  /** One column, oldest first. A view: valid until the next `append`. */
  column(name) {
    return this._columns.get(name).subarray(this.firstKept, this.length);
  }

  /** The newest value of a column, or NaN. */
  last(name) {
    return this.length ? this._columns.get(name)[this.length - 1] : NaN;
  }

  get lastTime() {
    return this.length ? this._time[this.length - 1] : NaN;
  }

  _compact() {
    const from = this.length - this.rows;
    this._time.copyWithin(0, from, this.length);
    for (const column of this._columns.values()) column.copyWithin(0, from, this.length);
    this.length = this.rows;
  }
}

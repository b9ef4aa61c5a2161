/**
 * The last minute of one end of the hand, a row a millisecond, in arrays that never grow.
 *
 * @import { Haptics } from "./wire.js"
 */

export class HapticTrace {
  /** @param {number} capacity Rows that are kept. */
  constructor(capacity) {
    this.capacity = capacity;
    /** Rows ever appended; row n lies at n modulo `capacity`. */
    this.appended = 0;
    /** Instants on the session's clock, µs. */
    this.timesUs = new Float64Array(capacity);
    /** By column of `Haptics`; they come with the first rows. @type {Float32Array[]} */
    this.values = [];
  }

  /** The number of the oldest row that is still kept. */
  get oldest() {
    return Math.max(0, this.appended - this.capacity);
  }

  /** The place of the newest row in the arrays, or -1 without any. */
  get newest() {
    return this.appended === 0 ? -1 : (this.appended - 1) % this.capacity;
  }

  /** @param {Haptics} haptics */
  append(haptics) {
    const { columns } = haptics;
    for (let more = this.values.length; more < columns.length; more += 1) {
      this.values.push(new Float32Array(this.capacity));
    }
    for (let row = 0; row < haptics.rows; row += 1) {
      const place = this.appended % this.capacity;
      this.timesUs[place] = haptics.timeUs[row];
      columns.forEach((column, value) => {
        /** @type {Float32Array} */ (this.values[value])[place] = column[row];
      });
      this.appended += 1;
    }
  }
}

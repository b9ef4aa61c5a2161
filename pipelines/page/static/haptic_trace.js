/**
 * The last minute of one end of the hand, a row a millisecond, in arrays that never grow.
 *
 * A row of a HAPTIC message has 32 octets: f64 time_us, f32 x_m, y_m, fx_n, fy_n, energy_uj,
 * u32 flags.
 */

export const ROW_OCTETS = 32;

/** What a bit of `flags` means. */
export const FLAG_CONTACT = 1;

/** The lit LED of a row's flags: 0 is none, n is LED n - 1.
 * @param {number} flags
 */
export function litOf(flags) {
  return (flags >>> 16) & 0xff;
}

/** Values of a row that can be drawn: the order of `HapticTrace.values`. */
export const X = 0;
export const Y = 1;
export const FX = 2;
export const FY = 3;

export class HapticTrace {
  /** @param {number} capacity rows that are kept */
  constructor(capacity) {
    this.capacity = capacity;
    /** Rows ever appended; row n lies at n modulo `capacity`. */
    this.appended = 0;
    /** Instants on the session's clock, µs. */
    this.timesUs = new Float64Array(capacity);
    /** Metres, metres, newtons, newtons. */
    this.values = [0, 1, 2, 3].map(() => new Float32Array(capacity));
    this.flags = new Uint32Array(capacity);
  }

  /** The number of the oldest row that is still kept. */
  get oldest() {
    return Math.max(0, this.appended - this.capacity);
  }

  /** The place of the newest row in the arrays, or -1 without any. */
  get newest() {
    return this.appended === 0 ? -1 : (this.appended - 1) % this.capacity;
  }

  /** Append the rows of one HAPTIC message.
   * @param {DataView} rows
   * @param {number} count
   */
  append(rows, count) {
    for (let row = 0; row < count; row++) {
      const at = row * ROW_OCTETS;
      const place = this.appended % this.capacity;
      this.timesUs[place] = rows.getFloat64(at, true);
      for (let value = 0; value < this.values.length; value++) {
        this.values[value][place] = rows.getFloat32(at + 8 + 4 * value, true);
      }
      this.flags[place] = rows.getUint32(at + 28, true);
      this.appended++;
    }
  }
}

/**
 * The newest row of one end of haptics, as long as it is fresh.
 *
 * @import { Connection } from "./connection.js"
 */
import { HapticFlag, litLed } from "./wire.js";

/** Without a newer row for so long, nothing is known of place and force. */
const FRESH_MS = 300;

/** @typedef {{xM: number, yM: number, forceXN: number, forceYN: number, contact: boolean, lit: number | null}} Row */

export class NewestRow {
  /** @type {Row | null} */
  #row = null;
  #receivedMs = 0;

  /** @param {Connection} connection @param {"joystick" | "robot"} end */
  constructor(connection, end) {
    connection.on("haptic", (haptics) => {
      const { rows, xM, yM, forceXN, forceYN, flags } = haptics;
      if (haptics.end !== end || rows === 0) return;
      const last = rows - 1;
      const flag = flags[last] ?? 0;
      this.#receivedMs = performance.now();
      this.#row = {
        xM: xM[last] ?? 0,
        yM: yM[last] ?? 0,
        forceXN: forceXN[last] ?? 0,
        forceYN: forceYN[last] ?? 0,
        contact: (flag & HapticFlag.CONTACT) !== 0,
        lit: litLed(flag),
      };
    });
  }

  /** @returns {Row | null} */
  get row() {
    return performance.now() - this.#receivedMs > FRESH_MS ? null : this.#row;
  }

  /** The size of the force, in N; null while nothing is known. */
  get forceN() {
    const row = this.row;
    return row === null ? null : Math.hypot(row.forceXN, row.forceYN);
  }
}

/**
 * The newest row of one end of haptics, as long as it is fresh.
 *
 * @import { Connection } from "./connection.js"
 */
import { HapticFlag, litLed } from "./wire.js";

/** Without a newer row for this long, nothing is known of place and force. */
const FRESH_MS = 300;
/** Smaller changes of place and force are not shown. */
const STEP_M = 0.0002;
const STEP_N = 0.04;

/** @typedef {{xM: number, yM: number, forceXN: number, forceYN: number, contact: boolean, deadMan: boolean, lit: number | null}} Row */

export class NewestRow {
  /** The newest row; null without a fresh one. @type {Row | null} */
  row = null;
  #receivedMs = 0;
  #shown = "";
  /** Called when a person could see the change. @type {() => void} */
  onchange = () => undefined;

  /** @param {Connection} connection @param {"joystick" | "robot"} end */
  constructor(connection, end) {
    connection.on("haptic", (haptics) => {
      const { rows, xM, yM, forceXN, forceYN, flags } = haptics;
      if (haptics.end !== end || rows === 0) return;
      const last = rows - 1;
      const flag = flags[last] ?? 0;
      this.#receivedMs = performance.now();
      this.#set({
        xM: xM[last] ?? 0,
        yM: yM[last] ?? 0,
        forceXN: forceXN[last] ?? 0,
        forceYN: forceYN[last] ?? 0,
        contact: (flag & HapticFlag.CONTACT) !== 0,
        deadMan: (flag & HapticFlag.DEAD_MAN) !== 0,
        lit: litLed(flag),
      });
    });
    setInterval(() => {
      if (performance.now() - this.#receivedMs > FRESH_MS) this.#set(null);
    }, FRESH_MS);
  }

  /** The size of the force, in N; null while nothing is known. */
  get forceN() {
    return this.row === null ? null : Math.hypot(this.row.forceXN, this.row.forceYN);
  }

  /** @param {Row | null} row */
  #set(row) {
    this.row = row;
    const shown =
      row === null
        ? ""
        : [row.xM / STEP_M, row.yM / STEP_M, row.forceXN / STEP_N, row.forceYN / STEP_N]
            .map(Math.round)
            .concat(Number(row.contact), Number(row.deadMan), row.lit ?? -1)
            .join();
    if (shown === this.#shown) return;
    this.#shown = shown;
    this.onchange();
  }
}

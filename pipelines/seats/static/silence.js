/** A longer step between two looks means that this thread was blocked, and may have unread messages. */
const MOST_STEP_MS = 50;

/**
 * How long the other side was silent while this thread could have heard it.
 *
 * A thread that was blocked finds what came meanwhile only afterwards, so that time does not count.
 */
export class Silence {
  #silentMs = 0;
  #lookedMs = -Infinity;

  /** A message was handled. */
  handleHeard() {
    this.#silentMs = 0;
  }

  /** Looks, which is to be done every 25 ms or so; returns the silence in ms. @param {number} nowMs */
  look(nowMs) {
    this.#silentMs += Math.min(nowMs - this.#lookedMs, MOST_STEP_MS);
    this.#lookedMs = nowMs;
    return this.#silentMs;
  }
}

/**
 * How far the session's clock is ahead of the page's, from pings.
 *
 * Of the last 16 answers the one with the least round trip counts: it waited least, so its error
 * is at most half of its round trip (RFC 5905, 10: the clock filter).
 */

const KEPT = 16;

export class ClockOffset {
  /** @type {{roundTripMs: number, offsetUs: number}[]} */
  #answers = [];

  /**
   * Takes an answer. sentMs, receivedMs: page clock. nowUs: the session's clock, in between.
   * @param {number} sentMs @param {number} nowUs @param {number} receivedMs
   */
  handleAnswer(sentMs, nowUs, receivedMs) {
    const roundTripMs = receivedMs - sentMs;
    if (!(roundTripMs >= 0)) return;
    const offsetUs = nowUs - 500 * (sentMs + receivedMs);
    this.#answers.push({ roundTripMs, offsetUs });
    if (this.#answers.length > KEPT) this.#answers.shift();
  }

  /** The offset and the round trip that it is from; null before the first answer. */
  get best() {
    return this.#answers.reduce(
      (best, one) => (best === null || one.roundTripMs < best.roundTripMs ? one : best),
      /** @type {{roundTripMs: number, offsetUs: number} | null} */ (null),
    );
  }
}

/** When to ping, in ms after the last ping: often for the first 2 s. @param {number} openForMs */
export const pingIntervalMs = (openForMs) => (openForMs < 2000 ? 250 : 1000);

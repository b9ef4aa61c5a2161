/** @import { Hand } from "./wire.js" */

/** The page must say at least this often what the hand does, or the handle is released. */
const PATIENCE_MS = 100;
/** Two news are at least so far apart, because the server closes a page that sends too many. */
const LEAST_APART_MS = 1.5;
/** A hand without news is sent again after this time. */
const AGAIN_MS = 3;

/** @type {Hand} */
const RELEASED = Object.freeze({ deadMan: false, x: 0, y: 0, buttons: 0 });

/**
 * Decides what is sent of the hand, and when: always while it is held, and once on its release.
 *
 * It lets go when the page says nothing for 100 ms, and when the server is lost. Then the page must
 * press anew: it may have missed a release.
 */
export class HandSender {
  /** @type {Hand | null} */
  #held = null;
  #heardMs = 0;
  #sentMs = -Infinity;
  /** Whether the page said something that was not sent yet, and when such news went out last. */
  #news = false;
  #newsMs = -Infinity;
  #releasing = false;
  #pressAnew = false;

  /** Whether the press is ignored, because page or server were silent during it. */
  get pressAnew() {
    return this.#pressAnew;
  }

  /** Whether there is something to send. */
  get active() {
    return this.#held !== null || this.#releasing;
  }

  /** The page says what the hand does. @param {Hand} hand @param {number} nowMs */
  handleHand(hand, nowMs) {
    this.#listen(nowMs);
    this.#heardMs = nowMs;
    if (!hand.deadMan) {
      this.#pressAnew = false;
      this.#release();
    } else if (!this.#pressAnew) {
      this.#held = hand;
      this.#news = true;
      this.#releasing = false;
    }
  }

  /** The server is lost: lets go; what is held now must be pressed anew. */
  handleLost() {
    if (this.#held === null) return;
    this.#pressAnew = true;
    this.#release();
  }

  /** What to send now, or null. @param {number} nowMs @returns {Hand | null} */
  pollTransmit(nowMs) {
    this.#listen(nowMs);
    if (this.#releasing) {
      this.#releasing = false;
      return RELEASED;
    }
    if (this.#held === null) return null;
    const news = this.#news && nowMs - this.#newsMs >= LEAST_APART_MS;
    if (!news && nowMs - this.#sentMs < AGAIN_MS) return null;
    if (news) this.#newsMs = nowMs;
    this.#news = false;
    this.#sentMs = nowMs;
    return this.#held;
  }

  /** Lets go if the page said nothing for too long. @param {number} nowMs */
  #listen(nowMs) {
    if (nowMs - this.#heardMs > PATIENCE_MS) this.handleLost();
  }

  #release() {
    if (this.#held === null) return;
    this.#held = null;
    this.#releasing = true;
  }
}

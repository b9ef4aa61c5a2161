/**
 * Where the robot's tip will be once the hand's newest command has arrived, and where that is in a
 * picture. No I/O.
 */

/** @typedef {{xM: number, yM: number}} Place On the board, in metres. */

/** A hand that moves less rests. */
const STILL_M = 0.0005;
/** The robot rests so long after it knows that the hand does. */
const SETTLED_US = 1_000_000;

export class TipPrediction {
  /** The robot's place less the hand's; null while nobody knows it. @type {Place | null} */
  #offset = null;
  /** The hand, while the button is pressed. @type {Place | null} */
  #hand = null;
  /** The robot, while the button is released. @type {Place | null} */
  #released = null;
  /** The robot, while it and the hand rest. @type {Place | null} */
  #atRest = null;
  /** The hand at its newest motion. @type {Place | null} */
  #moved = null;
  #movedUs = -Infinity;
  /** Of the newest press or release. */
  #changedUs = -Infinity;

  /** The tip, while the dead-man button is pressed; null while it is not known. */
  get tip() {
    const [hand, offset] = [this.#hand, this.#offset];
    if (hand === null || offset === null) return null;
    return this.#atRest ?? { xM: hand.xM + offset.xM, yM: hand.yM + offset.yM };
  }

  /**
   * The newest place of the hand. At a press the robot begins where it is, so the offset changes.
   * @param {Place} hand @param {boolean} pressed @param {number} nowUs
   */
  handleHand(hand, pressed, nowUs) {
    const changed = pressed !== (this.#hand !== null);
    if (changed) {
      this.#changedUs = nowUs;
      if (!pressed) this.#released = this.tip;
      else if (this.#released !== null) this.#offset = { xM: this.#released.xM - hand.xM, yM: this.#released.yM - hand.yM };
    }
    this.#hand = pressed ? hand : null;
    const moved = this.#moved;
    if (changed || moved === null || Math.hypot(hand.xM - moved.xM, hand.yM - moved.yM) > STILL_M) {
      [this.#moved, this.#movedUs, this.#atRest] = [hand, nowUs, null];
    }
  }

  /**
   * The robot has told its offset or its place. The offset counts while the button is pressed. The
   * place counts while it is released, and once hand and robot rest, because something may hold the
   * robot. What it told before it knew of the newest press or release is of no use.
   * @param {"offset" | "place"} what @param {Place} told @param {number} heardUs @param {number} roundTripMs
   */
  handleTold(what, told, heardUs, roundTripMs) {
    // Of the hand's motions the robot knew the ones before this.
    const knewUs = heardUs - 1000 * roundTripMs;
    if (knewUs <= this.#changedUs) return;
    if (what === "offset" && this.#hand !== null) this.#offset = told;
    if (what === "place" && this.#hand === null) this.#released = told;
    if (what === "place" && knewUs > this.#movedUs + SETTLED_US) this.#atRest = told;
  }

  /** Nothing is known any more, because nothing is heard of the hand. */
  forget() {
    this.#offset = this.#hand = this.#released = this.#atRest = null;
  }
}

/**
 * Where a place on the board is in a picture, as shares of its width and height; null behind the camera.
 * @param {readonly number[]} view The homography, row by row. @param {number} xM @param {number} yM
 */
export function shareOf(view, xM, yM) {
  const [u, v, w] = [0, 3, 6].map((row) => (view[row] ?? 0) * xM + (view[row + 1] ?? 0) * yM + (view[row + 2] ?? 0));
  if (u === undefined || v === undefined || w === undefined || w <= 0) return null;
  return { x: u / w, y: v / w };
}

/** The part of a box that a picture covers which is fitted into it. @param {number} width @param {number} height @param {number} aspect */
export function fitted(width, height, aspect) {
  const wide = Math.min(width, height * aspect);
  const high = wide / aspect;
  return { left: (width - wide) / 2, top: (height - high) / 2, wide, high };
}

/**
 * Where the robot's tip will be once the hand's newest command has arrived, and where that is in a
 * picture. No I/O.
 */

/** @typedef {{xM: number, yM: number}} Place On the board, in metres. */

export class TipPrediction {
  /** The robot's place less the hand's; null while nobody knows it. @type {Place | null} */
  #offset = null;
  /** Where the robot's tip was or will be led to. @type {Place | null} */
  #tip = null;
  #pressed = false;
  /** Of the newest press or release. */
  #changedUs = -Infinity;

  /** The tip, while the dead-man button is pressed; null while it is not known. */
  get tip() {
    return this.#pressed ? this.#tip : null;
  }

  /**
   * The newest place of the hand. At a press the robot begins where it is, so the offset changes.
   * @param {Place} hand @param {boolean} pressed @param {number} nowUs
   */
  handleHand(hand, pressed, nowUs) {
    if (pressed !== this.#pressed) {
      this.#changedUs = nowUs;
      if (pressed && this.#tip !== null) this.#offset = { xM: this.#tip.xM - hand.xM, yM: this.#tip.yM - hand.yM };
    }
    this.#pressed = pressed;
    if (pressed && this.#offset !== null) {
      this.#tip = { xM: hand.xM + this.#offset.xM, yM: hand.yM + this.#offset.yM };
    }
  }

  /**
   * The robot has told its offset, which counts while the button is pressed, or its place, which
   * counts otherwise. What it told before it knew of the newest press or release is of no use.
   * @param {"offset" | "place"} what @param {Place} told @param {number} heardUs @param {number} roundTripMs
   */
  handleTold(what, told, heardUs, roundTripMs) {
    if (heardUs <= this.#changedUs + 1000 * roundTripMs) return;
    if (what === "offset" && this.#pressed) this.#offset = told;
    if (what === "place" && !this.#pressed) this.#tip = told;
  }

  /** Nothing is known any more, because nothing is heard of the hand. */
  forget() {
    this.#offset = this.#tip = null;
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

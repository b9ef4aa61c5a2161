/**
 * When a block of sound was captured, on the page's clock.
 *
 * A block says when its first sample was captured on the sound device's clock. The block that came
 * with the least delay within some seconds gives the difference of the two clocks.
 */

const WINDOW_MS = 5000;
/** A larger jump means that the device's clock stood still. */
const JUMP_MS = 250;

export class BlockClock {
  #least = Infinity;
  #leastBefore = Infinity;
  #windowMs = -Infinity;

  /**
   * The page's time of a block's first sample.
   * @param {number} firstMs On the device's clock. @param {number} lengthMs Of the block.
   * @param {number} arrivedMs On the page's clock.
   */
  handleBlock(firstMs, lengthMs, arrivedMs) {
    const difference = arrivedMs - firstMs - lengthMs;
    if (difference - Math.min(this.#least, this.#leastBefore) > JUMP_MS) {
      this.#least = this.#leastBefore = Infinity;
    }
    if (arrivedMs - this.#windowMs > WINDOW_MS) {
      this.#leastBefore = this.#least;
      this.#least = Infinity;
      this.#windowMs = arrivedMs;
    }
    this.#least = Math.min(this.#least, difference);
    return firstMs + Math.min(this.#least, this.#leastBefore);
  }
}

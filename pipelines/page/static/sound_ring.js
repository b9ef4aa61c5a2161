/**
 * The samples of a voice between their arrival and their playing.
 *
 * Playing begins at 40 ms of stock, also after it ran dry. A stock above 120 ms is cut to 40 ms: the
 * oldest goes, because late speech is worth less. So does what was not needed for a second: the
 * least stock of that second beyond 40 ms.
 */

const SAMPLES_PER_MS = 48;
const TARGET = 40 * SAMPLES_PER_MS;
const MOST = 120 * SAMPLES_PER_MS;
const WINDOW = 1000 * SAMPLES_PER_MS;

export class SoundRing {
  /** @type {{samples: Int16Array, captureUs: number | null}[]} */
  #blocks = [];
  /** Samples of the first block that were played. */
  #played = 0;
  #stock = 0;
  #playing = false;
  /** The least stock since the window began, and the samples played in it. */
  #least = Infinity;
  #window = 0;
  /** Samples that were dropped because too many waited. */
  dropped = 0;
  /** How often it ran dry while it played. */
  dry = 0;

  /** How much waits, in ms. */
  get stockMs() {
    return this.#stock / SAMPLES_PER_MS;
  }

  /** When the sample that is next was captured, in µs; null if that is unknown or none waits. */
  get captureUs() {
    const first = this.#blocks[0];
    if (first === undefined || first.captureUs === null) return null;
    return first.captureUs + (1000 * this.#played) / SAMPLES_PER_MS;
  }

  /** @param {Int16Array} samples @param {number | null} captureUs Of the first sample. */
  handleSound(samples, captureUs) {
    this.#blocks.push({ samples, captureUs });
    this.#stock += samples.length;
    if (this.#stock > MOST) this.dropped += this.#skip(this.#stock - TARGET);
  }

  /** Fills `output` with the next samples, or with silence. @param {Float32Array} output */
  read(output) {
    if (!this.#playing && this.#stock >= TARGET) this.#playing = true;
    if (this.#playing && this.#stock < output.length) {
      this.#playing = false;
      this.dry += 1;
    }
    if (!this.#playing) {
      output.fill(0);
      return;
    }
    for (let at = 0; at < output.length; ) {
      const { samples } = /** @type {{samples: Int16Array}} */ (this.#blocks[0]);
      const count = Math.min(output.length - at, samples.length - this.#played);
      for (let index = 0; index < count; index += 1) {
        output[at + index] = /** @type {number} */ (samples[this.#played + index]) / 32768;
      }
      at += count;
      this.#skip(count);
    }
    this.#trim(output.length);
  }

  /** @param {number} played */
  #trim(played) {
    this.#least = Math.min(this.#least, this.#stock);
    this.#window += played;
    if (this.#window < WINDOW) return;
    if (this.#least > TARGET) this.dropped += this.#skip(this.#least - TARGET);
    this.#least = Infinity;
    this.#window = 0;
  }

  /** Drops the oldest samples; returns how many. @param {number} count */
  #skip(count) {
    for (let left = count; left > 0; ) {
      const first = this.#blocks[0];
      if (first === undefined) break;
      const step = Math.min(left, first.samples.length - this.#played);
      this.#played += step;
      left -= step;
      if (this.#played === first.samples.length) {
        this.#blocks.shift();
        this.#played = 0;
      }
    }
    this.#stock -= count;
    return count;
  }
}

/**
 * The samples of a voice between their arrival and their playing.
 *
 * A spare of 20 ms is kept beside the block that plays. Each time that it runs dry the spare grows by
 * 20 ms, to at most 60; after 10 s in which it did not it shrinks by 5 ms, to at least 10. Playing
 * begins with a block and the spare, also after it ran dry. A stock above 120 ms is cut to that: the
 * oldest goes, because late speech is worth less. So does what was not needed for a second: the
 * least stock of that second beyond the spare.
 */

const SAMPLES_PER_MS = 48;
const BLOCK = 20 * SAMPLES_PER_MS;
const MOST = 120 * SAMPLES_PER_MS;
const WINDOW = 1000 * SAMPLES_PER_MS;
const FIRST_SPARE = 20 * SAMPLES_PER_MS;
const LEAST_SPARE = 10 * SAMPLES_PER_MS;
const MOST_SPARE = 60 * SAMPLES_PER_MS;
const MORE = 20 * SAMPLES_PER_MS;
const LESS = 5 * SAMPLES_PER_MS;
/** So many windows without running dry shrink the spare. */
const CALM_WINDOWS = 10;

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
  #spare = FIRST_SPARE;
  #calm = 0;
  /** Samples that were dropped because too many waited. */
  dropped = 0;
  /** How often it ran dry while it played. */
  dry = 0;

  /** How much waits, in ms. */
  get stockMs() {
    return this.#stock / SAMPLES_PER_MS;
  }

  get #target() {
    return BLOCK + this.#spare;
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
    if (this.#stock > MOST) this.dropped += this.#skip(this.#stock - this.#target);
  }

  /** Fills `output` with the next samples, or with silence. @param {Float32Array} output */
  read(output) {
    if (!this.#playing && this.#stock >= this.#target) this.#playing = true;
    if (this.#playing && this.#stock < output.length) {
      this.#playing = false;
      this.dry += 1;
      this.#spare = Math.min(this.#spare + MORE, MOST_SPARE);
      this.#calm = 0;
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
    this.#calm += 1;
    if (this.#calm >= CALM_WINDOWS) {
      this.#spare = Math.max(this.#spare - LESS, LEAST_SPARE);
      this.#calm = 0;
    }
    if (this.#least > this.#spare) this.dropped += this.#skip(this.#least - this.#spare);
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

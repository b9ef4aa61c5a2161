import { codecOf } from "./avc.js";

/** @import { Unit } from "./wire.js" */

/**
 * A decoded picture that is to be drawn. The taker closes its frame.
 * @typedef {object} Decoded
 * @property {VideoFrame} frame
 * @property {number} sequence
 * @property {number | null} captureUs
 * @property {boolean} damaged
 */

/** Pictures that a decoder may hold back before their facts are forgotten. */
const UNDER_WAY = 64;

/**
 * Decodes one stream of H.264.
 *
 * A decoder begins with a key unit. One that closed on an error is opened anew by the next key
 * unit, which begins a replay. Replayed units are decoded, but do not come out.
 */
export class StreamDecoder {
  /** @type {VideoDecoder | null} */
  #decoder = null;
  #codec = "";
  #number = 0;
  /** What a unit said, by the timestamp that its picture has, too. @type {Map<number, Unit>} */
  #units = new Map();
  #onPicture;
  #onFault;

  /**
   * @param {(picture: Decoded) => void} onPicture
   * @param {(why: string) => void} onFault The decoder closed; the next key unit opens another.
   */
  constructor(onPicture, onFault) {
    this.#onPicture = onPicture;
    this.#onFault = onFault;
  }

  /** Whether a key unit is needed before any other can be decoded. */
  get waiting() {
    return this.#decoder === null;
  }

  /** @param {Unit} unit */
  handleUnit(unit) {
    if (unit.key) this.#prepare(unit);
    const decoder = this.#decoder;
    if (decoder === null) return;
    const timestamp = this.#number;
    this.#number += 1;
    this.#units.set(timestamp, unit);
    const type = unit.key ? "key" : "delta";
    try {
      decoder.decode(new EncodedVideoChunk({ type, timestamp, data: unit.data }));
    } catch (error) {
      this.#fail(decoder, String(error));
    }
  }

  close() {
    if (this.#decoder !== null && this.#decoder.state !== "closed") this.#decoder.close();
    this.#decoder = null;
    this.#units.clear();
  }

  /** @param {Unit} unit */
  #prepare(unit) {
    const codec = codecOf(unit.data) ?? this.#codec;
    if (codec === "" || (this.#decoder !== null && codec === this.#codec)) return;
    this.close();
    const decoder = new VideoDecoder({
      output: (frame) => this.#handleFrame(decoder, frame),
      error: (error) => this.#fail(decoder, error.message),
    });
    // Without a description the units are Annex B.
    decoder.configure({
      codec,
      optimizeForLatency: true,
      hardwareAcceleration: "prefer-software",
    });
    this.#decoder = decoder;
    this.#codec = codec;
  }

  /** @param {VideoDecoder} decoder @param {VideoFrame} frame */
  #handleFrame(decoder, frame) {
    const unit = this.#units.get(frame.timestamp);
    for (const timestamp of this.#units.keys()) {
      if (timestamp > frame.timestamp && this.#units.size <= UNDER_WAY) break;
      this.#units.delete(timestamp);
    }
    if (decoder !== this.#decoder || unit === undefined || unit.replayed) {
      frame.close();
      return;
    }
    const { sequence, captureUs, damaged } = unit;
    this.#onPicture({ frame, sequence, captureUs, damaged });
  }

  /** @param {VideoDecoder} decoder @param {string} why */
  #fail(decoder, why) {
    if (decoder !== this.#decoder) return;
    this.close();
    this.#onFault(why);
  }
}

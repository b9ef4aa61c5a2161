/**
 * Cuts a microphone's sound into blocks of 20 ms for the capture worker, and tells its level.
 *
 * A muted microphone sends silence: without blocks the input would fall back to its own source.
 *
 * @import { BlockNote, MicrophoneNote } from "./sound_messages.js"
 */
const BLOCK_SAMPLES = 960;
const NOTE_SAMPLES = 4800;

class MicrophoneBlocks extends AudioWorkletProcessor {
  /** @type {MessagePort | null} */
  #to = null;
  #muted = true;
  #closed = false;
  #block = new Int16Array(BLOCK_SAMPLES);
  #filled = 0;
  #firstMs = 0;
  #peak = 0;
  #sinceNote = 0;

  constructor() {
    super();
    this.port.onmessage = (/** @type {MessageEvent<{port?: MessagePort, muted?: boolean, closed?: boolean}>} */ event) => {
      this.#to = event.data.port ?? this.#to;
      this.#muted = event.data.muted ?? this.#muted;
      this.#closed = event.data.closed ?? this.#closed;
    };
  }

  /** @param {Float32Array[][]} inputs */
  process(inputs) {
    const input = inputs[0]?.[0];
    if (this.#closed) return false;
    if (input === undefined) return true;
    for (let index = 0; index < input.length; index += 1) {
      const sample = /** @type {number} */ (input[index]);
      this.#peak = Math.max(this.#peak, Math.abs(sample));
      if (this.#filled === 0) this.#firstMs = (1000 * (currentFrame + index)) / sampleRate;
      const cut = Math.max(-1, Math.min(1, sample));
      this.#block[this.#filled] = this.#muted ? 0 : Math.round(cut * 32767);
      this.#filled += 1;
      if (this.#filled === BLOCK_SAMPLES) this.#send();
    }
    this.#sinceNote += input.length;
    if (this.#sinceNote >= NOTE_SAMPLES) {
      /** @type {MicrophoneNote} */
      const note = { peak: this.#peak };
      this.port.postMessage(note);
      this.#peak = this.#sinceNote = 0;
    }
    return true;
  }

  #send() {
    /** @type {BlockNote} */
    const note = { samples: this.#block, firstMs: this.#firstMs };
    this.#to?.postMessage(note, [this.#block.buffer]);
    this.#block = new Int16Array(BLOCK_SAMPLES);
    this.#filled = 0;
  }
}

registerProcessor("microphone-blocks", MicrophoneBlocks);

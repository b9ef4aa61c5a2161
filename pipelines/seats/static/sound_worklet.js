/**
 * Plays the blocks of one voice that arrive on the port of `{port}`, and tells every 100 ms how
 * loud it is, how much waits, and when what is heard now was captured.
 *
 * @import { PlayingNote, SoundNote } from "./sound_messages.js"
 */
import { SoundRing } from "./sound_ring.js";

const NOTE_SAMPLES = 4800;

class SoundPlayer extends AudioWorkletProcessor {
  #ring = new SoundRing();
  #peak = 0;
  #sinceNote = 0;

  constructor() {
    super();
    this.port.onmessage = (event) => {
      /** @type {MessagePort} */
      const port = event.data.port;
      port.onmessage = (/** @type {MessageEvent<SoundNote>} */ sound) =>
        this.#ring.handleSound(sound.data.samples, sound.data.captureUs);
    };
  }

  /** @param {Float32Array[][]} _inputs @param {Float32Array[][]} outputs */
  process(_inputs, outputs) {
    const output = outputs[0]?.[0];
    if (output === undefined) return true;
    this.#ring.read(output);
    for (const sample of output) this.#peak = Math.max(this.#peak, Math.abs(sample));
    this.#sinceNote += output.length;
    if (this.#sinceNote >= NOTE_SAMPLES) {
      const { stockMs, captureUs, dropped, dry } = this.#ring;
      /** @type {PlayingNote} */
      const note = { peak: this.#peak, stockMs, captureUs, dropped, dry };
      this.port.postMessage(note);
      this.#peak = this.#sinceNote = 0;
    }
    return true;
  }
}

registerProcessor("sound-player", SoundPlayer);

/**
 * The loudspeaker: plays one voice, with volume, mute and level.
 *
 * @import { Connection } from "./connection.js"
 * @import { FigureBinding } from "./figure_binding.js"
 * @import { PlayingNote } from "./sound_messages.js"
 * @import { DeviceState } from "./sound_device.js"
 */
import { audioContext, followDevice } from "./sound_device.js";

const TROUBLE = Object.freeze({
  waiting: "press any key or click to hear",
  absent: "this machine has no sound device",
  failed: "this browser cannot play the voice",
});

export class SoundPlayer {
  #connection;
  #stream;
  #gain = audioContext().createGain();
  #volume = 1;
  #muted = false;
  /** @type {PlayingNote | null} */
  #playing = null;
  /** How old the sound was that left the worklet when it said so. @type {number | null} */
  #playedMs = null;
  /** @type {DeviceState | "failed"} */
  #device = "waiting";
  /** Called at each note and at each change, ten times a second at most. @type {() => void} */
  onchange = () => undefined;

  /** @param {Connection} connection @param {string} stream The name of the voice. */
  constructor(connection, stream) {
    this.#connection = connection;
    this.#stream = stream;
  }

  async start() {
    const context = audioContext();
    followDevice((device) => {
      this.#device = device;
      this.onchange();
    });
    try {
      await context.audioWorklet.addModule(new URL("sound_worklet.js", import.meta.url));
    } catch {
      this.#device = "failed";
      this.onchange();
      return;
    }
    const node = new AudioWorkletNode(context, "sound-player", {
      numberOfInputs: 0,
      outputChannelCount: [1],
    });
    node.connect(this.#gain).connect(context.destination);
    const channel = new MessageChannel();
    node.port.postMessage({ port: channel.port2 }, [channel.port2]);
    this.#connection.attachSound(this.#stream, channel.port1);
    node.port.onmessage = (event) => {
      this.#handleNote(event.data);
      this.onchange();
    };
  }

  /** 0 to 1. */
  get volume() {
    return this.#volume;
  }

  set volume(volume) {
    this.#volume = volume;
    this.#apply();
  }

  get muted() {
    return this.#muted;
  }

  set muted(muted) {
    this.#muted = muted;
    this.#apply();
  }

  /** The largest sample of the last 100 ms, 0 to 1, before volume and mute. */
  get peak() {
    return this.#device === "playing" ? (this.#playing?.peak ?? 0) : 0;
  }

  /** From the worklet to the loudspeaker, in ms, as the system says. */
  get outputMs() {
    const context = audioContext();
    return 1000 * (context.outputLatency || context.baseLatency || 0);
  }

  /** How much sound waits in the page, in ms. */
  get stockMs() {
    return this.#playing?.stockMs ?? 0;
  }

  /** How old what is heard now is, in ms; null if nothing is heard, or if it is undated. */
  get ageMs() {
    if (this.#device !== "playing" || this.#playedMs === null) return null;
    return this.#playedMs + this.outputMs;
  }

  /** Of what that is made, for people. */
  get details() {
    return `buffer ${this.stockMs.toFixed(0)} ms, output device ${this.outputMs.toFixed(0)} ms`;
  }

  /** One line for people. */
  get words() {
    if (this.#device !== "playing") return TROUBLE[this.#device];
    return `plays ${10 * Math.round((this.stockMs + this.outputMs) / 10)} ms late`;
  }

  /** @param {PlayingNote} note */
  #handleNote(note) {
    this.#playing = note;
    const nowUs = this.#connection.nowUs();
    const { captureUs } = note;
    this.#playedMs = nowUs === null || captureUs === null ? null : (nowUs - captureUs) / 1000;
  }

  #apply() {
    // A short ramp: a step would click.
    const gain = this.#muted ? 0 : this.#volume;
    this.#gain.gain.setTargetAtTime(gain, audioContext().currentTime, 0.01);
    this.onchange();
  }
}

/** Lets the figure `name` be the age of what is heard. @param {SoundPlayer} player @param {FigureBinding} figures @param {string} name */
export function bindSoundAge(player, figures, name) {
  setInterval(() => {
    const ageMs = player.ageMs;
    figures.setOwn(name, ageMs === null ? null : Math.round(ageMs));
  }, 200);
}

/**
 * The page's own microphone: takes an input over, with mute, a key to talk, and level.
 *
 * @import { Opened } from "./own_input.js"
 * @import { MicrophoneNote } from "./sound_messages.js"
 * @import { InputText } from "./texts.js"
 */
import { OwnInput, mediaDevices } from "./own_input.js";
import { audioContext } from "./sound_device.js";

export class OwnMicrophone extends OwnInput {
  /** @type {AudioWorkletNode | null} */
  #node = null;
  #muted = false;
  #talking = false;
  #peak = 0;

  /** @param {InputText} input */
  constructor(input) {
    super(input, (one) => this.#openMicrophone(one));
  }

  get muted() {
    return this.#muted;
  }

  set muted(muted) {
    this.#muted = muted;
    this.#tell();
  }

  /** Whether the key to talk is held; it goes before mute. */
  get talking() {
    return this.#talking;
  }

  /** Pressed while the microphone is off, the key turns it on, muted otherwise. */
  set talking(talking) {
    if (talking && (this.state === "off" || this.state === "failed")) {
      this.#muted = true;
      void this.turnOn();
    }
    this.#talking = talking;
    this.#tell();
  }

  /** Whether the other end hears this microphone. */
  get heard() {
    return this.state === "on" && (this.#talking || !this.#muted);
  }

  /** The largest sample of the last 100 ms, 0 to 1, also while muted. */
  get peak() {
    return this.state === "on" ? this.#peak : 0;
  }

  #tell() {
    this.#node?.port.postMessage({ muted: this.#muted && !this.#talking });
    this.onchange();
  }

  /** @param {InputText} input @returns {Promise<Opened>} */
  async #openMicrophone(input) {
    const devices = mediaDevices();
    const context = audioContext();
    await context.audioWorklet.addModule(new URL("capture_worklet.js", import.meta.url));
    const stream = await devices.getUserMedia({
      audio: { echoCancellation: true, noiseSuppression: true, channelCount: 1 },
    });
    const source = context.createMediaStreamSource(stream);
    const node = new AudioWorkletNode(context, "microphone-blocks", {
      numberOfOutputs: 0,
      channelCount: 1,
      channelCountMode: "explicit",
    });
    source.connect(node);
    node.port.onmessage = (/** @type {MessageEvent<MicrophoneNote>} */ event) => {
      this.#peak = event.data.peak;
      this.onchange();
    };
    const channel = new MessageChannel();
    node.port.postMessage({ port: channel.port2 }, [channel.port2]);
    this.#node = node;
    this.#tell();
    return {
      stream,
      order: { kind: "sound", input, port: channel.port1 },
      transfer: [channel.port1],
      close: () => {
        source.disconnect();
        node.port.postMessage({ closed: true });
        node.port.onmessage = null;
        this.#node = null;
      },
    };
  }
}

/**
 * Takes one input of the session over with the page's own camera or microphone, and gives it back.
 *
 * @import { CaptureNote, CaptureOrder } from "./capture_messages.js"
 * @import { InputText } from "./texts.js"
 */

/**
 * An open device: what its worker is told, what moves there, and how the device is closed.
 * @typedef {object} Opened
 * @property {MediaStream} stream
 * @property {CaptureOrder} order
 * @property {Transferable[]} transfer
 * @property {() => void} close
 */

/** @typedef {"off" | "asking" | "on" | "failed"} InputState */

export class OwnInput {
  /** @type {InputText} */
  input;
  /** @type {InputState} */
  state = "off";
  /** Why it failed, or what it waits for; one line for people. */
  words = "";
  /** @type {() => void} */
  onchange = () => undefined;
  #open;
  /** @type {Opened | null} */
  #opened = null;
  /** @type {Worker | null} */
  #worker = null;
  /** Counts the presses, so that a device that opens after "off" is closed at once. */
  #turn = 0;

  /** @param {InputText} input @param {(input: InputText) => Promise<Opened>} open */
  constructor(input, open) {
    this.input = input;
    this.#open = open;
    addEventListener("pagehide", () => this.turnOff());
  }

  /** The camera's stream, for the view of oneself. */
  get stream() {
    return this.#opened?.stream ?? null;
  }

  toggle() {
    if (this.state === "on" || this.state === "asking") this.turnOff();
    else void this.turnOn();
  }

  async turnOn() {
    this.turnOff();
    this.#turn += 1;
    const turn = this.#turn;
    this.#set("asking", "waiting for the browser's permission");
    let opened;
    try {
      opened = await this.#open(this.input);
    } catch (error) {
      if (turn === this.#turn) this.#set("failed", trouble(error, this.input.kind));
      return;
    }
    if (turn !== this.#turn) {
      close(opened);
      return;
    }
    this.#opened = opened;
    for (const track of opened.stream.getTracks()) {
      track.addEventListener("ended", () => this.#fail("the device was unplugged"));
    }
    this.#set("asking", "taking over");
    const worker = new Worker(new URL("capture_worker.js", import.meta.url), { type: "module" });
    worker.onmessage = (event) => this.#handleNote(event.data);
    worker.postMessage(opened.order, opened.transfer);
    this.#worker = worker;
  }

  turnOff() {
    this.#turn += 1;
    this.#stop();
    this.#set("off", "");
  }

  /** @param {CaptureNote} note */
  #handleNote(note) {
    if (note.kind === "taken") this.#set("on", "");
    else if (note.kind === "lost") this.#set("asking", "the server does not answer");
    else this.#fail(note.why);
  }

  /** @param {string} why */
  #fail(why) {
    this.#turn += 1;
    this.#stop();
    this.#set("failed", why);
  }

  #stop() {
    this.#worker?.terminate();
    this.#worker = null;
    if (this.#opened !== null) close(this.#opened);
    this.#opened = null;
  }

  /** @param {InputState} state @param {string} words */
  #set(state, words) {
    this.state = state;
    this.words = words;
    this.onchange();
  }
}

/** @param {Opened} opened */
function close(opened) {
  for (const track of opened.stream.getTracks()) track.stop();
  opened.close();
}

/** @param {unknown} error @param {"video" | "audio"} kind */
function trouble(error, kind) {
  const device = kind === "video" ? "camera" : "microphone";
  switch (error instanceof Error ? error.name : "") {
    case "NotAllowedError":
    case "SecurityError":
      return `the browser has no permission for the ${device}`;
    case "NotFoundError":
    case "OverconstrainedError":
      return `this machine has no ${device}`;
    case "NotReadableError":
    case "AbortError":
      return `the ${device} does not start; another program may have it`;
    default:
      return error instanceof Error ? error.message : String(error);
  }
}

/** The browser's devices. @returns {MediaDevices} */
export function mediaDevices() {
  // Absent in a page that came neither from this machine nor over HTTPS.
  if (navigator.mediaDevices === undefined) {
    throw new Error("browsers give camera and microphone only on 127.0.0.1 or over HTTPS");
  }
  return navigator.mediaDevices;
}

/** Its state in one line for people. @param {OwnInput} input */
export const inputWords = ({ state, words }) => (state === "off" ? "off" : words);

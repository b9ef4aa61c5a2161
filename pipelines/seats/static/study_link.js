/**
 * The page's connection to the server of a study, with what `HandControl` needs of a seat's.
 *
 * @import { HandLine } from "./hand_control.js"
 * @import { StudyFrame, StudyShown } from "./texts.js"
 * @import { Hand } from "./wire.js"
 */
import { writeHand } from "./wire.js";

const AGAIN_MS = 1000;
/** The server's close code where another page has taken the study. */
const TAKEN_OVER = 4001;

/**
 * @typedef {object} Events
 * @property {StudyShown} shown
 * @property {StudyFrame} frame
 * @property {string} lost Why.
 */

/** @implements {HandLine} */
export class StudyLink extends EventTarget {
  /** @type {WebSocket | null} */
  #socket = null;
  #sequence = 0;
  alive = false;
  mayAct = true;
  hindrance = "";
  /** @type {HandLine["hello"]} */
  hello = null;
  state = { hand: { holder: 1, you: true, who: "" }, now_us: 0 };

  /** @param {string} name @param {(event: any) => void} listener */
  on(name, listener) {
    this.addEventListener(name, (event) => listener(/** @type {CustomEvent} */ (event).detail));
  }

  /** Connects, and again after each loss. */
  open() {
    const address = new URL("../ws", document.baseURI);
    address.protocol = address.protocol === "https:" ? "wss:" : "ws:";
    const socket = new WebSocket(address);
    this.#socket = socket;
    socket.onmessage = ({ data }) => this.#take(JSON.parse(data));
    socket.onclose = ({ code }) => {
      this.alive = false;
      const gone = code === TAKEN_OVER;
      this.hindrance = gone ? "Another page has this study." : "The study's program does not answer.";
      this.#tell("lost", this.hindrance);
      if (!gone) setTimeout(() => this.open(), AGAIN_MS);
    };
  }

  /** Presses a button of a screen. @param {number} screen @param {boolean} other */
  press(screen, other) {
    this.#send(JSON.stringify({ screen, other }));
  }

  /** @param {Hand} hand */
  sendHand(hand) {
    this.#sequence += 1;
    this.#send(writeHand(hand, this.#sequence, -1));
  }

  /** The handle needs not be asked for. */
  request() {
    return Promise.resolve({ ok: true, error: "" });
  }

  nowUs() {
    return 0;
  }

  /** @param {string | ArrayBuffer} message */
  #send(message) {
    if (this.#socket?.readyState === WebSocket.OPEN) this.#socket.send(message);
  }

  /** @param {StudyShown | StudyFrame} text */
  #take(text) {
    if (text.kind === "study") {
      const { half_width_m, half_height_m } = text;
      this.alive = true;
      this.hindrance = "";
      this.hello = { joystick: "page", workspace: { half_width_m, half_height_m } };
      this.#tell("shown", text);
    } else {
      this.#tell("haptic", { end: "joystick", rows: 1, xM: [text.x_m], yM: [text.y_m] });
      this.#tell("frame", text);
    }
  }

  /** @param {string} name @param {unknown} detail */
  #tell(name, detail) {
    this.dispatchEvent(new CustomEvent(name, { detail }));
  }
}

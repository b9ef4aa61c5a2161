/**
 * `<contact-band>`: signal over the last two minutes as a band, and, of a pass, the window that the
 * orbit predicts with where in it we are.
 *
 * @import { StateText } from "./texts.js"
 */
import { fitCanvas } from "./canvas_size.js";
import { startDrawing, stopDrawing } from "./drawing_loop.js";
import { make, setText } from "./make.js";
import { CONNECTED, NO_SIGNAL, SIGNAL, SignalHistory } from "./signal_history.js";
import { token } from "./tokens.js";
import { clock } from "./wording.js";

/**
 * A predicted pass, in seconds since acquisition of signal.
 * @typedef {object} Pass
 * @property {number} nowS
 * @property {number} lossS
 * @property {number | null} usableFromS
 * @property {number | null} usableToS
 */

const SHOWN_S = 120;

export class ContactBand extends HTMLElement {
  #history = new SignalHistory(SHOWN_S);
  #nowUs = NaN;
  #drawnStep = NaN;
  #band = make("canvas", { class: "band", role: "img", "aria-label": "Signal over the last two minutes" });
  #context = /** @type {CanvasRenderingContext2D} */ (this.#band.getContext("2d"));
  #window = make("div", { class: "pass", role: "img" });
  #usable = make("i", { class: "pass-usable" });
  #now = make("i", { class: "pass-now" });
  #ahead = make("p", { class: "ahead" });

  connectedCallback() {
    if (this.childElementCount === 0) {
      this.#window.append(this.#usable, this.#now);
      this.#window.hidden = true;
      this.append(
        this.#band,
        make("p", { class: "time-axis" }, make("span", {}, "2 min ago"), make("span", {}, "now")),
        this.#window,
        this.#ahead,
      );
    }
    startDrawing(this);
  }

  disconnectedCallback() {
    stopDrawing(this);
  }

  /** @param {StateText} state */
  update(state) {
    this.#history.append(state.now_us, state.signal, state.link === "connected");
    this.#nowUs = state.now_us;
  }

  /** Let the band go on while the server is silent. @param {number} nowUs The session's clock. */
  advance(nowUs) {
    if (nowUs > this.#nowUs) this.#nowUs = nowUs;
  }

  /** @param {Pass | null} pass Null without a predicted pass. */
  set pass(pass) {
    this.#window.hidden = pass === null;
    if (pass === null) {
      setText(this.#ahead, "No pass: the channel has no end.");
      return;
    }
    const { nowS, lossS, usableFromS, usableToS } = pass;
    const share = (/** @type {number} */ second) => `${Math.min(100, Math.max(0, (100 * second) / lossS))}%`;
    this.#usable.hidden = usableFromS === null || usableToS === null;
    this.#usable.style.left = share(usableFromS ?? 0);
    this.#usable.style.width = share((usableToS ?? 0) - (usableFromS ?? 0));
    this.#now.style.left = share(nowS);
    const words =
      nowS < 0
        ? `acquisition of signal in ${clock(-nowS)}`
        : nowS < lossS
          ? `${clock(nowS)} since acquisition, loss of signal in ${clock(lossS - nowS)}`
          : `pass over since ${clock(nowS - lossS)}`;
    setText(this.#ahead, words);
    this.#window.setAttribute("aria-label", words);
  }

  /** Bring the canvas up to date; called by the drawing loop. */
  draw() {
    const step = Math.floor(this.#nowUs / 100_000);
    if (!fitCanvas(this.#band) && step === this.#drawnStep) return;
    this.#drawnStep = step;
    const context = this.#context;
    const { width, height } = this.#band;
    context.clearRect(0, 0, width, height);
    // Runs of one state are one rectangle. Lower is worse, so that colour is not needed.
    const looks = new Map([
      [CONNECTED, { colour: token("--good"), tall: 1 }],
      [SIGNAL, { colour: token("--warn"), tall: 0.5 }],
      [NO_SIGNAL, { colour: token("--bad"), tall: 0.2 }],
    ]);
    const steps = SHOWN_S * 10;
    for (let from = steps - 1; from >= 0; ) {
      const state = this.#history.at(this.#nowUs, from);
      let to = from - 1;
      while (to >= 0 && this.#history.at(this.#nowUs, to) === state) to -= 1;
      const look = looks.get(state);
      if (look !== undefined) {
        const left = Math.floor(((steps - 1 - from) / steps) * width);
        const right = Math.ceil(((steps - 1 - to) / steps) * width);
        context.fillStyle = look.colour;
        context.fillRect(left, height * (1 - look.tall), right - left, height * look.tall);
      }
      from = to;
    }
  }
}

customElements.define("contact-band", ContactBand);

/**
 * `<contact-band>`: signal over the last two minutes as a band and, of a pass, the window that the
 * orbit predicts, with where in it we are.
 *
 * @import { FigureBinding } from "./figure_binding.js"
 * @import { Seat } from "./seat.js"
 */
import { make, setText } from "./dom.js";
import { paint } from "./palette.js";
import { SharpCanvas } from "./sharp_canvas.js";
import { CONNECTED, NO_SIGNAL, SIGNAL, SignalHistory, STEP_US } from "./signal_history.js";
import { clockText, linkObstacle } from "./wording.js";

const SHOWN_S = 120;
const STEPS = (SHOWN_S * 1e6) / STEP_US;
const DRAW_MS = 500;

/** Lower is worse, so that colour is not needed. @type {Map<number, {colour: string, tall: number}>} */
const LOOKS = new Map([
  [CONNECTED, { colour: "--good", tall: 1 }],
  [SIGNAL, { colour: "--warn", tall: 0.6 }],
  [NO_SIGNAL, { colour: "--bad", tall: 0.3 }],
]);

class ContactBand extends HTMLElement {
  #history = new SignalHistory(STEPS);
  #nowUs = 0;
  #sharp = new SharpCanvas(() => this.#draw());
  #words = make("span", { class: "small" });
  #pass = make("div", { class: "pass", role: "img", hidden: true });
  #usable = make("i", { class: "pass-usable" });
  #now = make("i", { class: "pass-now" });
  #obstacle = make("p", { class: "small", role: "alert", "data-level": "bad", hidden: true });

  /** @param {Seat} seat */
  follow({ connection, figures }) {
    const { canvas } = this.#sharp;
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", "Signal over the last two minutes");
    this.#pass.append(this.#usable, this.#now);
    this.append(
      make("header", {}, make("h2", {}, "Contact"), this.#words),
      this.#obstacle,
      canvas,
      make("p", { class: "time-axis" }, make("span", {}, "2 min ago"), make("span", {}, "now")),
      this.#pass,
    );
    connection.on("state", ({ now_us, signal, link }) => {
      this.#history.append(now_us, signal, link === "connected");
    });
    connection.on("figures", () => this.#showPass(figures));
    // Also while the server is silent: then the band ends before its right edge.
    setInterval(() => {
      this.#nowUs = connection.nowUs() ?? 0;
      this.#draw();
    }, DRAW_MS);
  }

  /** @param {FigureBinding} figures */
  #showPass(figures) {
    const obstacle = linkObstacle(figures);
    this.#obstacle.hidden = obstacle === "";
    setText(this.#obstacle, obstacle);
    const sinceS = figures.number("contact.since_acquisition_s");
    const untilS = figures.number("contact.until_loss_s");
    this.#pass.hidden = sinceS === null || untilS === null;
    if (sinceS === null || untilS === null) {
      setText(this.#words, "no loss of signal planned");
      return;
    }
    const lossS = sinceS + untilS;
    const at = (/** @type {number} */ second) => Math.min(100, Math.max(0, (100 * second) / lossS));
    const from = figures.number("gateways.ground.radio.contact.usable_from_s");
    const to = figures.number("gateways.ground.radio.contact.usable_to_s");
    this.#usable.hidden = from === null || to === null;
    this.#usable.style.left = `${at(from ?? 0)}%`;
    this.#usable.style.width = `${at(to ?? 0) - at(from ?? 0)}%`;
    this.#now.style.left = `${at(sinceS)}%`;
    const ahead = `since ${clockText(sinceS)}, lost in ${clockText(untilS)}`;
    const words =
      sinceS < 0
        ? `signal in ${clockText(-sinceS)}`
        : untilS < 0
          ? `pass over since ${clockText(-untilS)}`
          : ahead;
    setText(this.#words, words);
    if (this.#pass.ariaLabel !== words) this.#pass.ariaLabel = words;
  }

  #draw() {
    const { width, height } = this.#sharp;
    if (width === 0) return;
    const context = this.#sharp.cleared();
    // Steps of one state are one rectangle.
    for (let from = STEPS - 1; from >= 0; ) {
      const state = this.#history.at(this.#nowUs, from);
      let to = from - 1;
      while (to >= 0 && this.#history.at(this.#nowUs, to) === state) to -= 1;
      const look = LOOKS.get(state);
      if (look !== undefined) {
        const left = Math.floor(((STEPS - 1 - from) / STEPS) * width);
        const right = Math.ceil(((STEPS - 1 - to) / STEPS) * width);
        context.fillStyle = paint(look.colour);
        context.fillRect(left, height * (1 - look.tall), right - left, height * look.tall);
      }
      from = to;
    }
  }
}

customElements.define("contact-band", ContactBand);

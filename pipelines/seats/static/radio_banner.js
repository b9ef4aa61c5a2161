/**
 * `<radio-banner>`: whether both directions of the radio carry, and whether telecommands are
 * acknowledged, as the server of this end knows it.
 *
 * @import { Seat } from "./seat.js"
 * @import { RadioText } from "./texts.js"
 */
import { announce } from "./announcer.js";
import { make, setText } from "./dom.js";

/** @type {Record<string, string>} */
const SIGNS = { good: "● ", warn: "▲ ", bad: "✕ ", none: "" };

class RadioBanner extends HTMLElement {
  #words = make("span");

  /** @param {Seat} seat */
  follow({ connection }) {
    this.append(this.#words);
    this.dataset.level = "none";
    /** @type {RadioText | null} */
    let newest = null;
    const show = () => {
      if (newest === null || !connection.alive) return;
      const { level, words } = newest;
      this.dataset.level = level;
      setText(this.#words, `${SIGNS[level]}${words}`);
    };
    connection.on("radio", (radio) => {
      newest = radio;
      show();
      if (radio.level === "bad") announce(radio.words);
    });
    // A server that was silent says only what changed.
    connection.on("heard", show);
    connection.on("lost", () => {
      this.dataset.level = "none";
      setText(this.#words, connection.ended ? "This session has ended: open the address of the new one." : "The server does not answer.");
    });
  }
}

customElements.define("radio-banner", RadioBanner);

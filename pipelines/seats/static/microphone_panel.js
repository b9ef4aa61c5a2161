/**
 * `<microphone-panel>`: the page's own microphone in place of the seat's audio input.
 *
 * @import { Seat } from "./seat.js"
 */
import { make, setText } from "./dom.js";
import { LevelMeter } from "./level_meter.js";
import { OwnMicrophone } from "./own_microphone.js";
import { inputWords } from "./own_input.js";

class MicrophonePanel extends HTMLElement {
  /** @type {OwnMicrophone | null} */
  #microphone = null;
  /** @type {Seat | null} */
  #seat = null;
  #on = make("button", { type: "button", "aria-pressed": "false", disabled: true }, "Microphone");
  #mute = make("button", { type: "button", "aria-pressed": "false", disabled: true }, "Mute");
  #meter = new LevelMeter();
  #words = make("span", { class: "quiet small", role: "status" });

  /** @param {Seat} seat */
  follow(seat) {
    const { connection, keyboard } = seat;
    this.#seat = seat;
    this.#meter.setAttribute("aria-label", "Level of your own microphone");
    this.append(
      make("header", {}, make("h2", {}, "Microphone"), this.#words),
      make("div", { class: "sound-row" }, this.#on, this.#mute, this.#meter),
    );
    this.#on.addEventListener("click", () => this.#microphone?.toggle());
    this.#mute.addEventListener("click", () => {
      if (this.#microphone !== null) this.#microphone.muted = !this.#microphone.muted;
    });
    /** @param {boolean} talking */
    const talk = (talking) => {
      if (this.#microphone !== null) this.#microphone.talking = talking;
    };
    keyboard.add({ keys: ["t"], what: "hold to talk", down: () => talk(true), up: () => talk(false) });
    connection.on("hello", ({ inputs, role }) => {
      const input = inputs.find((one) => one.kind === "audio");
      const usable = input !== undefined && role === "operator";
      if (!usable) this.#microphone?.turnOff();
      if (usable && this.#microphone === null) {
        this.#microphone = new OwnMicrophone(input);
        this.#microphone.onchange = () => this.#show();
      }
      if (usable && this.#microphone !== null) this.#microphone.input = input;
      this.#on.disabled = !usable;
      if (!usable) setText(this.#words, input === undefined ? "this setup carries no voice from here" : "a viewer may watch only");
      else this.#show();
    });
    for (const name of /** @type {const} */ (["state", "figures", "lost"])) {
      connection.on(name, () => this.#show());
    }
  }

  #show() {
    const microphone = this.#microphone;
    if (microphone === null) return;
    const on = microphone.state === "on" || microphone.state === "asking";
    this.#on.setAttribute("aria-pressed", String(on));
    setText(this.#on, on ? "On" : "Turn on");
    this.#mute.disabled = !on;
    this.#mute.setAttribute("aria-pressed", String(microphone.muted));
    if (microphone.state === "on") this.#meter.set(microphone.peak);
    else this.#meter.clear();
    const hindrance = this.#seat?.connection.hindrance ?? "";
    const heard = microphone.heard && hindrance === "";
    if (this.dataset.heard !== String(heard)) this.dataset.heard = String(heard);
    let words = inputWords(microphone);
    if (microphone.state === "on") words = heard ? "you are heard" : "muted: hold T to talk";
    if (microphone.heard && hindrance !== "") words = `nobody hears you: ${hindrance}`;
    setText(this.#words, words);
    this.#words.dataset.level = microphone.state === "failed" ? "bad" : heard ? "good" : "none";
  }
}

customElements.define("microphone-panel", MicrophonePanel);

/**
 * `<joystick-panel>`: the joystick's state, and the few requests that a person may make. With
 * `telecommands` they go by telecommand, which is verified, and its application is chosen here.
 *
 * The joystick decides which requests it takes; the next one that makes sense is marked.
 *
 * @import { Seat } from "./seat.js"
 */
import { joystickWords } from "./conditions.js";
import { make, setText } from "./dom.js";

/** @typedef {"calibrate" | "start" | "stop" | "halt" | "resume" | "acknowledge"} OwnRequest */
/** @typedef {OwnRequest | "test" | "start_russian"} JoystickRequest */

/** @type {[JoystickRequest, string][]} */
const REQUESTS = [
  ["calibrate", "Calibrate"],
  ["start", "Start"],
  ["stop", "Stop"],
  ["halt", "Halt"],
  ["resume", "Resume"],
  ["acknowledge", "Acknowledge"],
];

/** What the joystick is used for, in the place of start and stop. @type {[JoystickRequest, string][]} */
const APPLICATIONS = [
  ["start", "German experiment"],
  ["start_russian", "Russian experiment"],
  ["test", "Joystick test"],
  ["stop", "Stop experiment"],
];

/** @type {Record<string, "good" | "warn" | "bad">} */
const LEVELS = {
  application: "good",
  "calibration error": "bad",
  "recoverable error": "bad",
  "fatal error": "bad",
};

/** By outcome of the newest functional test. @type {Record<string, "good" | "bad">} */
const TESTED = { passed: "good", failed: "bad", aborted: "bad" };

class JoystickPanel extends HTMLElement {
  #state = make("strong", { class: "joystick-state" }, "–");
  #dead = make("span", { class: "lamp" }, "dead-man");
  #limit = make("span", { class: "quiet small" });
  #age = make("span", { class: "quiet small" });
  #reason = make("p", { class: "small", hidden: true });
  #answer = make("p", { class: "small", role: "status" });
  /** @type {Map<JoystickRequest, HTMLButtonElement>} */
  #buttons = new Map();
  /** @type {Seat | null} */
  #seat = null;

  /** @param {Seat} seat */
  follow(seat) {
    this.#seat = seat;
    const chosen = this.hasAttribute("telecommands") ? APPLICATIONS : [];
    const others = REQUESTS.filter(([event]) => !chosen.some(([one]) => one === event));
    this.append(
      make("header", {}, make("h2", {}, "Joystick"), this.#age, this.#limit),
      make("div", { class: "joystick-line" }, this.#state, this.#dead),
      this.#reason,
      ...(chosen.length > 0 ? [make("h2", {}, "Application"), this.#row(chosen), make("h2", {}, "Joystick itself")] : []),
      this.#row(others),
      this.#answer,
    );
    seat.keyboard.add({ keys: ["x"], what: "halt the joystick", down: () => void this.#request("halt") });
    const show = () => this.#show();
    seat.connection.on("hello", show);
    seat.connection.on("state", show);
    seat.connection.on("lost", show);
    show();
  }

  /** @param {[JoystickRequest, string][]} requests */
  #row(requests) {
    const buttons = make("div", { class: "buttons" });
    for (const [event, words] of requests) {
      const button = make("button", { type: "button", "data-joystick": event }, words);
      if (event === "halt") button.classList.add("danger");
      button.addEventListener("click", () => void this.#request(event));
      this.#buttons.set(event, button);
      buttons.append(button);
    }
    return buttons;
  }

  /** @param {JoystickRequest} event */
  async #request(event) {
    const connection = this.#seat?.connection;
    if (connection === undefined) return;
    setText(this.#answer, `${event} …`);
    this.#answer.dataset.level = "none";
    const { ok, error, round_trip_ms: ms } = await (event === "test" || event === "start_russian" || this.hasAttribute("telecommands")
      ? connection.request({ do: "command", application: "joystick", name: event })
      : connection.request({ do: "joystick", event }));
    const verified = ms === undefined ? "" : ` after ${ms.toFixed(0)} ms`;
    setText(this.#answer, ok ? `${event}: taken${verified}` : `refused: ${error}`);
    this.#answer.dataset.level = ok ? "none" : "bad";
  }

  #show() {
    const connection = this.#seat?.connection;
    if (connection === undefined) return;
    const joystick = connection.alive ? (connection.state?.joystick ?? null) : null;
    const state = joystick?.state ?? "–";
    setText(this.#state, state);
    this.#state.dataset.level = LEVELS[state] ?? "none";
    const dead = joystick?.dead_man === true;
    this.#dead.dataset.on = String(dead);
    setText(this.#dead, joystick === null ? "" : dead ? "● dead-man held" : "○ dead-man released");
    const limitN = joystick?.force_limit_n ?? 0;
    setText(this.#limit, limitN > 0 ? `force up to ${limitN.toFixed(1)} N` : "no force");
    const ageMs = joystick?.command_age_ms ?? null;
    setText(this.#age, ageMs === null ? "" : `the robot gets it within ${ageMs} ms`);
    const reason = joystick === null ? "" : joystickWords(joystick, this.hasAttribute("telecommands"));
    setText(this.#reason, reason);
    this.#reason.hidden = reason === "";
    this.#reason.dataset.level = joystick === null ? "none" : (TESTED[joystick.test] ?? "none");
    for (const [event, button] of this.#buttons) {
      button.disabled = !connection.mayAct || joystick?.allowed.includes(event) !== true;
      // Most sessions have no partner's robot.
      button.hidden = event === "start_russian" && typeof joystick?.partner !== "boolean";
      button.classList.toggle("main", joystick?.request === event);
    }
  }
}

customElements.define("joystick-panel", JoystickPanel);

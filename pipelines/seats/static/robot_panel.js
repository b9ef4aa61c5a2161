/**
 * `<robot-panel>`: the robot's housekeeping, and what the experimenter may tell it: power, the
 * mode of the next power on, and to forget an error.
 *
 * @import { Seat } from "./seat.js"
 * @import { RobotText } from "./texts.js"
 */
import { make, setText } from "./dom.js";
import { MODE_WORDS } from "./mission_words.js";

const MM_PER_M = 1000;
/** A status comes 20 times a second; without one for this long, the controller is not heard. */
const FRESH_MS = 1000;

/** Name of the function, and what stands on its button. @type {[string, string][]} */
const FUNCTIONS = [
  ["power_on", "Power on"],
  ["power_off", "Power off"],
  ["reset_error", "Reset error"],
  ["set_mode", "Set mode"],
];

class RobotPanel extends HTMLElement {
  #state = make("strong", { class: "robot-state" }, "–");
  #fault = make("p", { class: "small", "data-level": "bad" });
  #answer = make("p", { class: "small", role: "status" });
  #mode = make("select", { "aria-label": "Mode of the next power on" });
  /** @type {Map<string, HTMLElement>} */
  #values = new Map();
  /** @type {Map<string, HTMLButtonElement>} */
  #buttons = new Map();
  #heardMs = -Infinity;

  /** @param {Seat} seat */
  follow({ connection }) {
    const list = make("dl", { class: "values" });
    for (const name of ["Mode", "Place", "Goal", "Force of the board", "Joystick", "Orders refused", "Faults so far"]) {
      const value = make("dd", {}, "–");
      this.#values.set(name, value);
      list.append(make("dt", {}, name), value);
    }
    const buttons = make("div", { class: "buttons" });
    for (const [name, words] of FUNCTIONS) {
      const button = make("button", { type: "button", "data-robot": name, ...(name === "power_off" ? { class: "danger" } : {}) }, words);
      button.addEventListener("click", () => void this.#ask(connection, name));
      this.#buttons.set(name, button);
      buttons.append(button);
    }
    for (const [value, words] of Object.entries(MODE_WORDS)) this.#mode.append(make("option", { value }, words));
    this.#buttons.get("set_mode")?.before(this.#mode);
    this.append(make("header", {}, make("h2", {}, "Robot"), this.#state), this.#fault, list, buttons, this.#answer);
    connection.on("robot", (robot) => {
      this.#heardMs = performance.now();
      this.#show(robot, connection.mayAct);
    });
    setInterval(() => {
      if (performance.now() - this.#heardMs > FRESH_MS) this.dataset.old = "true";
    }, FRESH_MS);
  }

  /** @param {RobotText} robot @param {boolean} mayAct */
  #show(robot, mayAct) {
    delete this.dataset.old;
    const { powered, fault } = robot;
    setText(this.#state, fault !== "" ? "✕ FAULT" : powered ? "● powered" : "○ off");
    this.#state.dataset.level = fault !== "" ? "bad" : powered ? "good" : "none";
    setText(this.#fault, fault);
    this.#fault.hidden = fault === "";
    this.#set("Mode", MODE_WORDS[robot.mode] ?? robot.mode);
    this.#set("Place", placeText([robot.x_m, robot.y_m]));
    this.#set("Goal", robot.goal_m === null ? "–" : placeText(robot.goal_m));
    this.#set("Force of the board", `${robot.push_n.toFixed(1)} N`);
    this.#set("Joystick", robot.halted ? "halted" : "not halted");
    this.#set("Orders refused", String(robot.refused));
    this.#set("Faults so far", String(robot.faults));
    for (const [name, button] of this.#buttons) {
      const useful = { power_on: !powered, power_off: powered, reset_error: fault !== "", set_mode: !powered }[name] ?? true;
      button.disabled = !mayAct || !useful;
      button.classList.toggle("main", name === "reset_error" && useful);
    }
    this.#mode.disabled = !mayAct || powered;
  }

  /** @param {string} name @param {string} text */
  #set(name, text) {
    const value = this.#values.get(name);
    if (value !== undefined) setText(value, text);
  }

  /** @param {Seat["connection"]} connection @param {string} name */
  async #ask(connection, name) {
    const chosen = name === "set_mode" ? [this.#mode.value] : [];
    setText(this.#answer, `${[name.replaceAll("_", " "), ...chosen].join(" ")} …`);
    this.#answer.dataset.level = "none";
    const { ok, error } = await connection.request({ do: "command", application: "robot", name, arguments: chosen });
    setText(this.#answer, ok ? "" : `refused: ${error}`);
    this.#answer.dataset.level = ok ? "good" : "bad";
  }
}

/** @param {[number, number]} place */
const placeText = ([x, y]) => `${(x * MM_PER_M).toFixed(1)}, ${(y * MM_PER_M).toFixed(1)} mm`;

customElements.define("robot-panel", RobotPanel);

/**
 * `<stop-control>`: the emergency stop of the robot, and why the robot follows no hand. Where the
 * page has no robot panel, what leads on at the robot is a button here.
 *
 * @import { Connection } from "./connection.js"
 * @import { Seat } from "./seat.js"
 */
import { announce } from "./announcer.js";
import { robotWords, situationOf } from "./conditions.js";
import { make, setText } from "./dom.js";

/** By name of what to do next: the robot's function. @type {Record<string, string>} */
const DEEDS = { "power on": "power_on", "reset the robot": "reset_error" };

/** What stands on the button of a function. @type {Record<string, string>} */
const WORDS = { power_on: "Power on", power_off: "Power off", reset_error: "Reset error", set_mode: "Set mode telepresence" };

export class StopControl extends HTMLElement {
  #words = make("output", { class: "stop-words" });
  #stop = make("button", { type: "button", class: "emergency", "data-stop": "stop" }, "STOP", make("kbd", {}, "."));
  #release = make("button", { type: "button", "data-stop": "release", hidden: true }, "Release the stop");
  #deed = make("button", { type: "button", class: "main", "data-stop": "robot", hidden: true });
  #deedName = "";
  #refusal = make("span", { class: "refusal", role: "alert" });
  #stopped = false;
  /** Orders the stop. Resolves to why it was refused, or "". @type {() => Promise<string>} */
  stop = async () => "the page has not started";

  /** @param {Seat} seat */
  follow({ connection, keyboard }) {
    this.stop = () => this.#ask(connection, "stop");
    this.#stop.addEventListener("click", () => void this.stop());
    this.#release.addEventListener("click", () => void this.#ask(connection, "release"));
    this.#deed.addEventListener("click", () => void this.#order(connection));
    keyboard.add({ keys: ["."], what: "emergency stop of the robot", down: () => void this.stop() });
    this.append(this.#words, this.#refusal, this.#deed, this.#release, this.#stop);
    const show = () => this.#show(connection);
    for (const kind of /** @type {const} */ (["hello", "state", "robot", "lost"])) connection.on(kind, show);
    show();
  }

  /** @param {Connection} connection */
  #show(connection) {
    const safety = connection.alive ? (connection.state?.safety ?? null) : null;
    const stopped = safety?.stopped === true;
    this.#stop.disabled = !connection.mayAct || safety === null;
    this.#release.hidden = !stopped;
    this.#release.disabled = this.#stop.disabled;
    const { next, why } = situationOf(connection) ?? { next: "", why: "" };
    const mode = why === "robot off" ? "set_mode" : "power_off";
    this.#deedName = next === "power off, set mode" ? mode : (DEEDS[next] ?? "");
    this.#deed.hidden = this.#deedName === "" || document.querySelector("robot-panel") !== null;
    setText(this.#deed, WORDS[this.#deedName] ?? "");
    const { words, level } = robotWords(connection);
    this.dataset.level = level;
    setText(this.#words, words);
    if (stopped && !this.#stopped) announce("emergency stop");
    this.#stopped = stopped;
  }

  /** @param {Connection} connection */
  async #order(connection) {
    const name = this.#deedName;
    setText(this.#refusal, "");
    const chosen = name === "set_mode" ? ["telepresence"] : [];
    const { ok, error } = await connection.request({ do: "command", application: "robot", name, arguments: chosen });
    if (!ok) setText(this.#refusal, error);
  }

  /** @param {Connection} connection @param {"stop" | "release"} action */
  async #ask(connection, action) {
    if (!connection.mayAct) return "a viewer may watch only";
    setText(this.#refusal, "");
    const { ok, error } = await connection.request({ do: "stop", action });
    if (!ok) setText(this.#refusal, error);
    return ok ? "" : error;
  }
}

customElements.define("stop-control", StopControl);

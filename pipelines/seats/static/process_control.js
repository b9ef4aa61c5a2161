/**
 * `<process-control>`: stops, starts and restarts a process of either end, by telecommands to the
 * supervisors. The log of telecommands says what becomes of them.
 *
 * @import { Seat } from "./seat.js"
 * @import { ApplicationText } from "./texts.js"
 */
import { make, setText } from "./dom.js";
import { nameText } from "./wording.js";

/** What stands on a button, and the functions that it calls. @type {[string, string[]][]} */
const DEEDS = [
  ["Restart", ["stop", "start"]],
  ["Stop", ["stop"]],
  ["Start", ["start"]],
];

class ProcessControl extends HTMLElement {
  #process = make("select", { "aria-label": "Process of either end" });
  #answer = make("p", { class: "small", role: "status" });

  /** @param {Seat} seat */
  follow({ connection }) {
    const buttons = DEEDS.map(([words, functions]) => {
      const button = make("button", { type: "button", "data-deed": words.toLowerCase() }, words);
      button.addEventListener("click", () => void this.#send(connection, functions));
      return button;
    });
    this.append(make("div", { class: "telecommand" }, this.#process, ...buttons), this.#answer);
    connection.on("hello", ({ applications, role }) => {
      const chosen = this.#process.value;
      this.#process.replaceChildren(...applications.flatMap(processOptions));
      if (chosen !== "") this.#process.value = chosen;
      for (const button of buttons) button.disabled = role === "viewer";
    });
  }

  /** @param {Seat["connection"]} connection @param {string[]} functions */
  async #send(connection, functions) {
    // Before the first connection the list is empty.
    if (this.#process.value === "") return;
    const [application, process] = this.#process.value.split(" ");
    for (const name of functions) {
      const words = `${name} ${nameText(process)}`;
      setText(this.#answer, `${words} …`);
      this.#answer.dataset.level = "none";
      const { ok, error } = await connection.request({ do: "command", application, verb: "call", name, arguments: [process] });
      setText(this.#answer, ok ? `${words}: done` : `${words}: refused: ${error}`);
      this.#answer.dataset.level = ok ? "good" : "bad";
      if (!ok) return;
    }
  }
}

/** @param {ApplicationText} application */
function processOptions({ name, end, parameters }) {
  const known = name.endsWith("_supervisor") ? parameters.find((one) => one.name === "process") : undefined;
  return (known?.choices ?? []).map((process) => make("option", { value: `${name} ${process}` }, `${end}: ${nameText(process)}`));
}

customElements.define("process-control", ProcessControl);

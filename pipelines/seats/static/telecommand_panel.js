/**
 * `<telecommand-panel>`: any function of any application, a sign of life, and reports on, off and
 * now. The server refuses what the page's role may not.
 *
 * @import { Seat } from "./seat.js"
 * @import { ApplicationText, Verb } from "./texts.js"
 */
import { make, setText } from "./dom.js";
import { nameText } from "./wording.js";

/** @typedef {{words: string, verb: Verb, name: string, arguments: string[]}} Choice */

class TelecommandPanel extends HTMLElement {
  #application = make("select", { "aria-label": "Application" });
  #what = make("select", { "aria-label": "Telecommand" });
  #arguments = make("span", { class: "telecommand-arguments" });
  /** @type {(HTMLInputElement | HTMLSelectElement)[]} */
  #fields = [];
  #answer = make("p", { class: "small", role: "status" });
  /** @type {ApplicationText[]} */
  #applications = [];
  /** @type {Choice[]} */
  #choices = [];

  /** @param {Seat} seat */
  follow({ connection }) {
    const send = make("button", { type: "submit" }, "Send");
    const form = make("form", { class: "telecommand" }, this.#application, this.#what, this.#arguments, send);
    this.append(make("header", {}, make("h2", {}, "Send a telecommand")), form, this.#answer);
    this.#application.addEventListener("change", () => this.#offer());
    this.#what.addEventListener("change", () => this.#offerArguments());
    connection.on("hello", ({ applications, role }) => {
      this.#applications = applications;
      const chosen = this.#application.value;
      this.#application.replaceChildren(...applications.map(({ name }) => make("option", { value: name }, nameText(name))));
      if (applications.some(({ name }) => name === chosen)) this.#application.value = chosen;
      send.disabled = role === "viewer";
      this.#offer();
    });
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      void this.#send(connection);
    });
  }

  #offer() {
    const application = this.#applications.find(({ name }) => name === this.#application.value);
    if (application === undefined) return;
    this.#choices = [
      ...application.functions.map(({ name, arguments: given }) => choice(nameText(name), "call", name, given)),
      choice("are you alive?", "ping", ""),
      ...application.structures.flatMap(({ name }) => [
        choice(`report ${nameText(name)} now`, "report", name),
        choice(`report ${nameText(name)} on`, "housekeeping_on", name),
        choice(`report ${nameText(name)} off`, "housekeeping_off", name),
      ]),
    ];
    this.#what.replaceChildren(...this.#choices.map(({ words }, index) => make("option", { value: String(index) }, words)));
    this.#offerArguments();
  }

  #offerArguments() {
    const given = this.#choices[Number(this.#what.value)]?.arguments ?? [];
    const application = this.#applications.find(({ name }) => name === this.#application.value);
    this.#fields = given.map((name) => {
      const choices = application?.parameters.find((one) => one.name === name)?.choices ?? [];
      const label = { "aria-label": nameText(name) };
      if (choices.length === 0) return make("input", { type: "text", maxlength: "64", placeholder: nameText(name), ...label });
      return make("select", label, ...choices.map((value) => make("option", { value }, nameText(value))));
    });
    this.#arguments.replaceChildren(...this.#fields);
  }

  /** @param {Seat["connection"]} connection */
  async #send(connection) {
    const chosen = this.#choices[Number(this.#what.value)];
    if (chosen === undefined) return;
    const given = this.#fields.map(({ value }) => argument(value));
    const words = `${nameText(this.#application.value)} ${chosen.words}`;
    setText(this.#answer, `${words} …`);
    this.#answer.dataset.level = "none";
    const { ok, error, round_trip_ms: ms } = await connection.request({
      do: "command",
      application: this.#application.value,
      verb: chosen.verb,
      name: chosen.name,
      arguments: given,
    });
    setText(this.#answer, ok ? `${words}: verified after ${(ms ?? 0).toFixed(0)} ms` : `refused: ${error}`);
    this.#answer.dataset.level = ok ? "good" : "bad";
  }
}

/** @param {string} words @param {Verb} verb @param {string} name @param {string[]} [given] @returns {Choice} */
const choice = (words, verb, name, given = []) => ({ words, verb, name, arguments: given });

/** @param {string} word @returns {string | number | boolean} */
function argument(word) {
  const text = word.trim();
  if (text === "true" || text === "false") return text === "true";
  const number = Number(text);
  const whole = !Number.isInteger(number) || Number.isSafeInteger(number);
  return text !== "" && Number.isFinite(number) && whole ? number : text;
}

customElements.define("telecommand-panel", TelecommandPanel);

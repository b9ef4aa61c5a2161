/**
 * `<session-control>`: whether the session runs, for how long, and its start and stop. A stop asks
 * again, because it ends the operator's work too.
 *
 * @import { AnswerText } from "./texts.js"
 */
import { make, setAttribute, setText } from "./make.js";
import { clock } from "./wording.js";

/** @typedef {"start" | "stop"} Action */

export class SessionControl extends HTMLElement {
  /** Ask the server; set before the first press. @type {(action: Action) => Promise<AnswerText>} */
  request = () => Promise.reject(new Error("session-control: nobody to ask"));
  #state = make("output", { class: "session-state" }, "–");
  #time = make("span", { class: "number", title: "session time" });
  #start = make("button", { type: "button", id: "session-start" }, "Start");
  #stop = make("button", { type: "button", id: "session-stop" }, "Stop…");
  #error = make("span", { class: "refusal", role: "alert" });
  #dialog = make("dialog", { id: "session-ask", "aria-labelledby": "session-ask-title" });

  connectedCallback() {
    if (this.childElementCount > 0) return;
    const confirm = make("button", { type: "button", class: "danger", id: "session-stop-confirm" }, "Stop the session");
    const cancel = make("button", { type: "button", autofocus: "" }, "Let it run");
    this.#dialog.append(
      make("h2", { id: "session-ask-title" }, "Stop the session?"),
      make("p", {}, "Pictures, voices and the hand end at both seats. It can be started again from here."),
      make("div", { class: "buttons" }, cancel, confirm),
    );
    cancel.addEventListener("click", () => this.#dialog.close());
    confirm.addEventListener("click", () => {
      this.#dialog.close();
      void this.#ask("stop");
    });
    this.#stop.addEventListener("click", () => this.#dialog.showModal());
    this.#start.addEventListener("click", () => void this.#ask("start"));
    this.append(this.#state, this.#time, this.#start, this.#stop, this.#error, this.#dialog);
  }

  /** @param {"running" | "stopped" | null} state Null while nobody says. @param {number} seconds @param {boolean} mayAct */
  update(state, seconds, mayAct) {
    setText(this.#state, state ?? "unknown");
    setAttribute(this.#state, "data-state", state);
    setText(this.#time, clock(seconds));
    this.#start.hidden = state !== "stopped";
    this.#stop.hidden = state === "stopped";
    this.#start.disabled = !mayAct || state === null;
    this.#stop.disabled = !mayAct || state === null;
    const why = mayAct ? null : "who watches only cannot start or stop the session";
    setAttribute(this.#start, "title", why);
    setAttribute(this.#stop, "title", why);
  }

  /** @param {Action} action */
  async #ask(action) {
    setText(this.#error, "");
    const answer = await this.request(action);
    if (!answer.ok) setText(this.#error, answer.error);
  }
}

customElements.define("session-control", SessionControl);

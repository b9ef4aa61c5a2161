/**
 * `<session-control>`: whether the session runs, for how long, and its start and stop. A stop asks
 * again, because it ends the operator's work too.
 *
 * @import { Connection } from "./connection.js"
 * @import { Seat } from "./seat.js"
 */
import { make, setAttribute, setText } from "./dom.js";
import { clockText } from "./wording.js";

class SessionControl extends HTMLElement {
  #state = make("output", { class: "session-state" }, "–");
  #time = make("span", { class: "number", title: "session time" });
  #start = make("button", { type: "button", id: "session-start", hidden: true }, "Start session");
  #stop = make("button", { type: "button", id: "session-stop" }, "End session…");
  #error = make("span", { class: "refusal", role: "alert" });
  #dialog = make("dialog", { id: "session-ask", "aria-labelledby": "session-ask-title" });

  /** @param {Seat} seat */
  follow({ connection }) {
    const confirm = make("button", { type: "button", class: "danger", id: "session-stop-confirm" }, "End the session");
    const cancel = make("button", { type: "button", autofocus: true }, "Let it run");
    this.#dialog.append(
      make("h2", { id: "session-ask-title" }, "End the session?"),
      make("p", {}, "Pictures, voices and the hand end at both seats. It can be started again from here."),
      make("div", { class: "buttons" }, cancel, confirm),
    );
    cancel.addEventListener("click", () => this.#dialog.close());
    confirm.addEventListener("click", () => {
      this.#dialog.close();
      void this.#ask(connection, "stop");
    });
    this.#stop.addEventListener("click", () => this.#dialog.showModal());
    this.#start.addEventListener("click", () => void this.#ask(connection, "start"));
    this.append(this.#state, this.#time, this.#start, this.#stop, this.#error, this.#dialog);
    connection.on("figures", ({ state, seconds }) => this.#show(state, seconds, connection.mayAct));
    connection.on("lost", () => this.#show(null, NaN, connection.mayAct));
  }

  /** @param {"running" | "stopped" | null} state Null while nobody says. @param {number} seconds @param {boolean} mayAct */
  #show(state, seconds, mayAct) {
    setText(this.#state, state ?? "unknown");
    setAttribute(this.#state, "data-state", state);
    setText(this.#time, clockText(seconds));
    this.#start.hidden = state !== "stopped";
    this.#stop.hidden = state === "stopped";
    this.#start.disabled = !mayAct || state === null;
    this.#stop.disabled = !mayAct || state === null;
    const why = mayAct ? null : "who watches only cannot start or end the session";
    setAttribute(this.#start, "title", why);
    setAttribute(this.#stop, "title", why);
  }

  /** @param {Connection} connection @param {"start" | "stop"} action */
  async #ask(connection, action) {
    setText(this.#error, "");
    const answer = await connection.request({ do: "session", action });
    if (!answer.ok) setText(this.#error, answer.error);
  }
}

customElements.define("session-control", SessionControl);

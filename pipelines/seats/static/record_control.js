/**
 * `<record-control>`: begins and ends a recording of the session, and says how it goes.
 *
 * @import { Connection } from "./connection.js"
 * @import { Seat } from "./seat.js"
 * @import { Figure } from "./texts.js"
 */
import { make, setAttribute, setText } from "./dom.js";

class RecordControl extends HTMLElement {
  #button = make("button", { type: "button", id: "record" }, "Record");
  #said = make("output", { class: "recorded" });
  #error = make("span", { class: "refusal", role: "alert" });
  #recording = false;
  #asking = false;

  /** @param {Seat} seat */
  follow({ connection }) {
    this.append(this.#button, this.#said, this.#error);
    this.#button.addEventListener("click", () => void this.#ask(connection));
    connection.on("figures", ({ figures }) => this.#show(figures, connection.mayAct));
    connection.on("lost", () => this.#show({}, false));
  }

  /** @param {Readonly<Record<string, Figure>>} figures @param {boolean} mayAct */
  #show(figures, mayAct) {
    const file = figures["recorder.file"];
    const octets = figures["recorder.octets"];
    const lost = Number(figures["recorder.lost"] ?? 0);
    const fault = figures["recorder.fault"];
    this.#recording = typeof file === "string";
    this.#button.disabled = !mayAct || this.#asking || file === undefined;
    setAttribute(this.#button, "data-recording", this.#recording ? "true" : null);
    setText(this.#button, this.#recording ? "Stop rec." : "Record");
    const size = `${(Number(octets ?? 0) / 1e6).toFixed(1)} MB`;
    const missing = lost > 0 ? `, ${lost} messages lost` : "";
    setText(this.#said, this.#recording ? `${fault ?? size}${missing}` : "");
    setAttribute(this.#said, "title", this.#recording ? String(file) : null);
    setAttribute(this.#said, "data-fault", this.#recording && (fault || lost) ? "true" : null);
  }

  /** @param {Connection} connection */
  async #ask(connection) {
    setText(this.#error, "");
    this.#asking = true;
    this.#button.disabled = true;
    const answer = await connection.request({ do: "record", action: this.#recording ? "stop" : "start" });
    this.#asking = false;
    if (!answer.ok) setText(this.#error, answer.error);
  }
}

customElements.define("record-control", RecordControl);

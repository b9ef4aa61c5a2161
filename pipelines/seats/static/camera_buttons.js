/**
 * `<camera-buttons>`: selects the camera that the uplink carries, by click or by number; shows the
 * acknowledgement: pending, its round trip, or why it failed.
 *
 * @import { Seat } from "./seat.js"
 * @import { CameraText } from "./texts.js"
 */
import { make, setText } from "./dom.js";

class CameraButtons extends HTMLElement {
  #buttons = make("div", { class: "buttons" });
  #answer = make("span", { class: "small", role: "status" });
  /** @type {Seat | null} */
  #seat = null;
  /** @type {CameraText[]} */
  #cameras = [];
  /** The number of the newest selection; only its answer is shown. */
  #number = 0;

  /** @param {Seat} seat */
  follow(seat) {
    this.#seat = seat;
    const { connection, keyboard } = seat;
    this.append(make("h2", {}, "Camera"), this.#buttons, this.#answer);
    keyboard.add({
      keys: ["1", "2", "3", "4", "5", "6", "7", "8", "9"],
      shown: "1 … 9",
      what: "select a camera",
      down: (key) => void this.#select(this.#cameras[Number(key) - 1]),
    });
    connection.on("hello", ({ cameras }) => {
      this.#cameras = cameras;
      this.#buttons.replaceChildren(...cameras.map((camera, index) => this.#button(camera, index)));
      this.#show();
    });
    connection.on("state", () => this.#show());
    connection.on("lost", () => this.#show());
  }

  /** @param {CameraText} camera @param {number} index */
  #button(camera, index) {
    const key = index < 9 ? [make("kbd", {}, String(index + 1))] : [];
    const button = make("button", { type: "button", "data-camera": camera.name }, camera.name, ...key);
    button.addEventListener("click", () => void this.#select(camera));
    return button;
  }

  /** @param {CameraText | undefined} camera */
  async #select(camera) {
    const connection = this.#seat?.connection;
    if (camera === undefined || connection === undefined) return;
    this.#number += 1;
    const number = this.#number;
    this.#mark(camera.name);
    this.#say(`${camera.name}: waiting for the acknowledgement …`, "warn");
    const chosen = { application: "camera", name: "select", arguments: [camera.name] };
    const answer = await connection.request({ do: "command", ...chosen });
    if (number !== this.#number) return;
    this.#mark(null);
    const trip = answer.round_trip_ms;
    const took = trip === undefined || trip === null ? "" : ` in ${trip.toFixed(0)} ms`;
    if (answer.ok) this.#say(`✓ ${camera.name}: acknowledged${took}`, "good");
    else this.#say(`✕ ${camera.name}: ${answer.error}`, "bad");
  }

  /** @param {string} words @param {"good" | "warn" | "bad"} level */
  #say(words, level) {
    setText(this.#answer, words);
    this.#answer.dataset.level = level;
  }

  /** Marks the camera whose selection is pending. @param {string | null} name */
  #mark(name) {
    for (const button of this.#buttons.querySelectorAll("button")) {
      button.dataset.pending = String(button.dataset.camera === name);
    }
  }

  #show() {
    const connection = this.#seat?.connection;
    if (connection === undefined) return;
    const { alive, state, mayAct } = connection;
    for (const button of this.#buttons.querySelectorAll("button")) {
      const selected = state !== null && button.dataset.camera === state.camera;
      if (button.getAttribute("aria-current") !== String(selected)) {
        button.setAttribute("aria-current", String(selected));
      }
      button.disabled = !alive || !mayAct;
    }
  }
}

customElements.define("camera-buttons", CameraButtons);

/**
 * `<camera-panel>`: the page's own camera in place of the seat's video input, and a view of it.
 *
 * @import { Seat } from "./seat.js"
 */
import { make, setText } from "./dom.js";
import { openCamera } from "./own_camera.js";
import { OwnInput, inputWords } from "./own_input.js";

class CameraPanel extends HTMLElement {
  /** @type {OwnInput | null} */
  #camera = null;
  #on = make("button", { type: "button", "aria-pressed": "false", disabled: true }, "Turn on");
  #words = make("span", { class: "quiet small", role: "status" });
  #view = make("video", { muted: true, autoplay: true, playsinline: true, hidden: true, "aria-label": "Your own camera" });

  /** @param {Seat} seat */
  follow({ connection }) {
    this.append(
      make("header", {}, make("h2", {}, "Own camera"), this.#words),
      make("div", { class: "camera-row" }, this.#on, this.#view),
    );
    this.#view.muted = true;
    this.#on.addEventListener("click", () => this.#camera?.toggle());
    connection.on("hello", ({ inputs, role }) => {
      const input = inputs.find((one) => one.kind === "video");
      const usable = input !== undefined && role === "operator";
      // A setup without a picture from this seat has no use for a camera.
      this.hidden = input === undefined;
      if (!usable) this.#camera?.turnOff();
      if (usable && this.#camera === null) {
        this.#camera = new OwnInput(input, openCamera);
        this.#camera.onchange = () => this.#show();
      }
      if (usable && this.#camera !== null) this.#camera.input = input;
      this.#on.disabled = !usable;
      if (usable) this.#show();
      else setText(this.#words, "a viewer may watch only");
    });
  }

  #show() {
    const camera = this.#camera;
    if (camera === null) return;
    const on = camera.state === "on" || camera.state === "asking";
    this.#on.setAttribute("aria-pressed", String(on));
    setText(this.#on, on ? "On" : "Turn on");
    if (this.#view.srcObject !== camera.stream) this.#view.srcObject = camera.stream;
    this.#view.hidden = camera.stream === null;
    setText(this.#words, camera.state === "on" ? "you are seen" : inputWords(camera));
    this.#words.dataset.level =
      camera.state === "failed" ? "bad" : camera.state === "on" ? "good" : "none";
  }
}

customElements.define("camera-panel", CameraPanel);

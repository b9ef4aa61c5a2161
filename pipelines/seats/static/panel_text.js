/**
 * `<panel-text>`: what the current task is about.
 *
 * @import { Seat } from "./seat.js"
 */
import { make, setText } from "./dom.js";
import { nameText } from "./wording.js";

class PanelText extends HTMLElement {
  /** @param {Seat} seat */
  follow({ connection }) {
    const name = make("strong", { class: "panel-task" });
    const text = make("p");
    this.append(make("header", {}, make("h2", {}, "Task"), name), text);
    connection.on("panel", (panel) => {
      setText(name, panel.task === "" ? "" : `${nameText(panel.task)}, run ${panel.run}`);
      setText(text, panel.task === "" ? "There is none now." : panel.text);
    });
  }
}

customElements.define("panel-text", PanelText);

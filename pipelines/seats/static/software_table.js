/**
 * `<software-table>`: which version or copy runs at each end, by the status in its keeper's inbox.
 * A button fetches the status from the other end.
 *
 * @import { Seat } from "./seat.js"
 * @import { SoftwareText } from "./texts.js"
 */
import { make, setText } from "./dom.js";

class SoftwareTable extends HTMLElement {
  /** @param {Seat} seat */
  follow({ connection }) {
    const none = make("p", { class: "small quiet" }, "Nothing is known yet: fetch what an inbox in space tells.");
    const list = make("ul", { class: "software" });
    const inbox = make("input", { type: "text", maxlength: "64", placeholder: "inbox, such as joystick", "aria-label": "Inbox in space", required: true });
    const button = make("button", { type: "submit" }, "Fetch");
    const answer = make("p", { class: "small", role: "status" });
    const form = make("form", { class: "telecommand" }, inbox, button);
    this.append(make("header", {}, make("h2", {}, "Software")), none, list, form, answer);
    connection.on("hello", ({ role }) => {
      button.disabled = role === "viewer";
    });
    connection.on("upkeep", ({ files, software }) => {
      none.hidden = software.length > 0;
      form.hidden = !files;
      list.replaceChildren(...software.map(softwareRow));
    });
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      void connection.request({ do: "fetch", inbox: inbox.value.trim() }).then(({ ok, error }) => {
        setText(answer, ok ? "It is fetched beside the media." : `refused: ${error}`);
        answer.dataset.level = ok ? "good" : "bad";
      });
    });
  }
}

/** Of AppLoader's copies, the first is prime. @param {string} name */
const copyText = (name) => (/^(sd|ftp)\/[12]$/.test(name) ? `${name} (${name.endsWith("1") ? "prime" : "backup"})` : name);

/** @param {SoftwareText} software */
function softwareRow({ end, inbox, written, runs, why, states, waiting, busy, answers }) {
  const lines = Object.entries(states).map(([name, state]) => {
    const level = /^(valid|executable)$/.test(state) ? "good" : /^new$/.test(state) ? "none" : "bad";
    return make("span", { class: "small", "data-level": level }, `${copyText(name)}: ${state}`);
  });
  if (waiting.length > 0) lines.push(make("span", { class: "small" }, `waiting${busy ? " for the end of the experiment" : ""}: ${waiting.join(", ")}`));
  const newest = answers.at(-1);
  if (newest !== undefined) lines.push(make("span", { class: "small quiet" }, newest));
  return make(
    "li",
    {},
    make("strong", {}, `${inbox}: ${runs === "" ? "nothing runs" : copyText(runs)}`),
    make("span", { class: "small" }, `mode: ${why}`),
    ...lines,
    make("span", { class: "small quiet" }, `${end}, told ${written} UTC`),
  );
}

customElements.define("software-table", SoftwareTable);

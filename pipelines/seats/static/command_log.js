/**
 * `<command-log>`: the telecommands of this seat and what became of them, the newest first. All
 * pages of the seat show the same.
 *
 * @import { Seat } from "./seat.js"
 * @import { CommandLine } from "./texts.js"
 */
import { make } from "./dom.js";
import { clockText } from "./wording.js";

class CommandLog extends HTMLElement {
  /** @param {Seat} seat */
  follow({ connection }) {
    const list = make("ol", { class: "log", tabindex: "0", "aria-label": "Telecommands, newest first" });
    this.append(make("header", {}, make("h2", {}, "Telecommands")), list);
    let beganUs = 0;
    /** @type {readonly CommandLine[]} */
    let newest = [];
    const show = () => {
      list.replaceChildren(...newest.toReversed().map((line) => row(line, beganUs)));
    };
    connection.on("figures", ({ at_us, seconds }) => {
      const before = beganUs;
      beganUs = at_us - 1e6 * seconds;
      if (before === 0) show();
    });
    connection.on("commands", ({ commands }) => {
      newest = commands;
      show();
    });
  }
}

/** @param {CommandLine} line */
function became({ stage, done, ok, verified, reason, round_trip_ms: ms, tries }) {
  const again = (tries ?? 0) > 1 ? `, sent ${tries} times` : "";
  if (stage === "unacknowledged") return `? not acknowledged yet${again} …`;
  if (done !== true) return `${stage} …`;
  if (ok === true) return `✓ ${stage} after ${(ms ?? 0).toFixed(0)} ms${again}`;
  const words = stage === "failed" && verified !== true ? "not acknowledged" : stage;
  return `✕ ${words}${again}${reason === undefined || reason === "" ? "" : `: ${reason}`}`;
}

/** @param {CommandLine} line @param {number} beganUs */
function row(line, beganUs) {
  const level = line.done === true ? (line.ok === true ? "good" : "bad") : line.stage === "unacknowledged" ? "warn" : "none";
  return make(
    "li",
    {},
    make("time", {}, beganUs === 0 ? "" : clockText((line.at_us - beganUs) / 1e6)),
    make("span", { class: "log-what" }, line.words),
    make("span", { class: "log-text", "data-level": level, title: line.who }, became(line)),
  );
}

customElements.define("command-log", CommandLog);

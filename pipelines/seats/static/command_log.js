/**
 * `<command-log>`: the telecommands of this seat and what became of them, the newest first.
 *
 * @import { Seat } from "./seat.js"
 * @import { CommandLine } from "./texts.js"
 */
import { commandText } from "./mission_words.js";
import { followLog } from "./seat_log.js";

class CommandLog extends HTMLElement {
  /** @param {Seat} seat */
  follow(seat) {
    const tasks = () => (seat.connection.experiment?.tasks ?? []).map(({ name }) => name);
    followLog(this, seat, "Telecommands", "commands", ({ commands }) => commands, (line) => row(line, tasks()));
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

/** @param {CommandLine} line @param {readonly string[]} tasks */
function row(line, tasks) {
  const level = line.done === true ? (line.ok === true ? "good" : "bad") : line.stage === "unacknowledged" ? "warn" : "none";
  return { what: commandText(line.words, tasks), text: became(line), level, title: line.who };
}

customElements.define("command-log", CommandLog);

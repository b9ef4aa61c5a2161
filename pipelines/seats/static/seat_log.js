/**
 * A log of a seat: its lines with their times since the session began, the newest first. All pages
 * of the seat show the same.
 *
 * @import { Events } from "./connection.js"
 * @import { Seat } from "./seat.js"
 */
import { make } from "./dom.js";
import { clockText } from "./wording.js";

/** What a line shows. @typedef {{what: string, text: string, level: string, attributes?: Record<string, string>, title?: string}} Row */

/**
 * Fills an element with a log.
 * @template {keyof Events} Name
 * @template {{at_us: number}} Line
 * @param {HTMLElement} element @param {Seat} seat
 * @param {string} title
 * @param {Name} name The event that brings all lines.
 * @param {(event: Events[Name]) => readonly Line[]} linesOf
 * @param {(line: Line) => Row} rowOf
 */
export function followLog(element, { connection }, title, name, linesOf, rowOf) {
  const list = make("ol", { class: "log", tabindex: "0", "aria-label": `${title}, newest first` });
  element.append(make("header", {}, make("h2", {}, title)), list);
  let beganUs = 0;
  /** @type {readonly Line[]} */
  let newest = [];
  /** @param {Line} line */
  const row = (line) => {
    const { what, text, level, attributes = {}, title: hint } = rowOf(line);
    return make(
      "li",
      attributes,
      make("time", {}, beganUs === 0 ? "" : clockText((line.at_us - beganUs) / 1e6)),
      make("span", { class: "log-what" }, what),
      make("span", { class: "log-text", "data-level": level, title: hint ?? false }, text),
    );
  };
  const show = () => list.replaceChildren(...newest.toReversed().map(row));
  connection.on("figures", ({ at_us, seconds }) => {
    const before = beganUs;
    beganUs = at_us - 1e6 * seconds;
    if (before === 0) show();
  });
  connection.on(name, (event) => {
    newest = linesOf(event);
    show();
  });
}

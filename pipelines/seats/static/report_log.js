/**
 * `<report-log>`: the events that applications of both ends reported, the newest first.
 *
 * @import { Seat } from "./seat.js"
 * @import { EventLine } from "./texts.js"
 */
import { followLog } from "./seat_log.js";
import { valueText } from "./telemetry.js";
import { nameText } from "./wording.js";

/** @type {Record<string, string>} */
const LEVELS = { info: "none", low: "warn", medium: "warn", high: "bad" };

class ReportLog extends HTMLElement {
  /** @param {Seat} seat */
  follow(seat) {
    followLog(this, seat, "Reported events", "events", ({ events }) => events, row);
  }
}

/** @param {EventLine} line */
function row({ application, name, severity, values }) {
  const given = Object.entries(values).map(([key, value]) => `${nameText(key)} ${valueText(value)}`);
  return {
    what: nameText(application),
    text: [nameText(name), ...given].join(", "),
    level: LEVELS[severity] ?? "none",
    attributes: { "data-severity": severity },
  };
}

customElements.define("report-log", ReportLog);

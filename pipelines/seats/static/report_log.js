/**
 * `<report-log>`: the events that applications of both ends reported, the newest first.
 *
 * @import { Seat } from "./seat.js"
 * @import { EventLine } from "./texts.js"
 */
import { make } from "./dom.js";
import { valueText } from "./telemetry.js";
import { clockText, nameText } from "./wording.js";

/** @type {Record<string, string>} */
const LEVELS = { info: "none", low: "warn", medium: "warn", high: "bad" };

class ReportLog extends HTMLElement {
  /** @param {Seat} seat */
  follow({ connection }) {
    const list = make("ol", { class: "log", tabindex: "0", "aria-label": "Reported events, newest first" });
    this.append(make("header", {}, make("h2", {}, "Reported events")), list);
    let beganUs = 0;
    /** @type {readonly EventLine[]} */
    let newest = [];
    const show = () => {
      list.replaceChildren(...newest.toReversed().map((line) => row(line, beganUs)));
    };
    connection.on("figures", ({ at_us, seconds }) => {
      const before = beganUs;
      beganUs = at_us - 1e6 * seconds;
      if (before === 0) show();
    });
    connection.on("events", ({ events }) => {
      newest = events;
      show();
    });
  }
}

/** @param {EventLine} line @param {number} beganUs */
function row({ at_us, application, name, severity, values }, beganUs) {
  const given = Object.entries(values).map(([key, value]) => `${nameText(key)} ${valueText(value)}`);
  const words = [nameText(name), ...given].join(", ");
  return make(
    "li",
    { "data-severity": severity },
    make("time", {}, beganUs === 0 ? "" : clockText((at_us - beganUs) / 1e6)),
    make("span", { class: "log-what" }, nameText(application)),
    make("span", { class: "log-text", "data-level": LEVELS[severity] ?? "none" }, words),
  );
}

customElements.define("report-log", ReportLog);

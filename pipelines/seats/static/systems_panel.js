/**
 * `<systems-panel>`: the state of each system in one line: joystick, gateways, robot, tasks. A
 * system that was not heard of lately is marked.
 *
 * @import { Seat } from "./seat.js"
 * @import { Level } from "./texts.js"
 */
import { make, setAttribute, setText } from "./dom.js";
import { Telemetry, ageS, isOld, valueText } from "./telemetry.js";
import { agoText, nameText } from "./wording.js";

/** Name, application, parameter. @type {[string, string, string][]} */
const SYSTEMS = [
  ["Joystick (RJo)", "joystick", "state"],
  ["Experiment", "joystick", "application"],
  ["Gateway in space (OBC)", "space_gateway", "state"],
  ["Gateway on the ground (OGC)", "ground_gateway", "state"],
  ["Robot", "robot", "mode"],
  ["Robot's error", "robot", "error"],
  ["Panel", "panel", "mode"],
  ["Tasks", "tasks", "phase"],
];
const TICK_MS = 500;
/** By value: how good it is. @type {Record<string, Level>} */
const LEVELS = {
  connected: "good",
  application: "good",
  telepresence: "good",
  "german experiment": "good",
  halted: "warn",
  off: "warn",
  refused: "bad",
  "recoverable error": "bad",
  "fatal error": "bad",
  "calibration error": "bad",
  limit: "bad",
  fault: "bad",
};

class SystemsPanel extends HTMLElement {
  /** @param {Seat} seat */
  follow({ connection }) {
    const telemetry = new Telemetry(connection);
    const list = make("dl", { class: "systems" });
    const rows = SYSTEMS.map(([name, application, parameter]) => {
      const value = make("dd", { class: "system-value" }, "–");
      const age = make("dd", { class: "number quiet small" });
      const row = make("div", { "data-system": `${application}.${parameter}`, hidden: true }, make("dt", {}, name), value, age);
      list.append(row);
      return { row, value, age, application, parameter };
    });
    this.append(make("header", {}, make("h2", {}, "Systems")), list);
    const show = () => {
      const nowUs = connection.nowUs();
      for (const { row, value, age, application, parameter } of rows) {
        const known = telemetry.applications.find(({ name }) => name === application);
        row.hidden = known?.parameters.every(({ name }) => name !== parameter) ?? true;
        const newest = telemetry.get(application, parameter);
        const structure = known?.structures.find(({ parameters }) => parameters.includes(parameter));
        const seconds = ageS(newest, nowUs);
        const text = valueText(newest?.value);
        const old = isOld(seconds, structure?.interval_s ?? Infinity);
        setText(value, nameText(text));
        setAttribute(value, "data-level", old ? "none" : (LEVELS[text] ?? "none"));
        setAttribute(row, "data-old", old ? "true" : null);
        setText(age, seconds === null ? "never" : agoText(seconds));
      }
    };
    telemetry.onchange = show;
    setInterval(show, TICK_MS);
  }
}

customElements.define("systems-panel", SystemsPanel);

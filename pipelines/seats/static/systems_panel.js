/**
 * `<systems-panel>`: the state of each system in one line: joystick, gateways, robot, tasks. A
 * system that was not heard of lately, or that is beyond a lost link, is marked.
 *
 * @import { Seat } from "./seat.js"
 */
import { make, setAttribute, setText } from "./dom.js";
import { Telemetry, systemSays } from "./telemetry.js";
import { agoText, nameText } from "./wording.js";

/** Name, application, parameter. @type {[string, string, string][]} */
const SYSTEMS = [
  ["Joystick (RJo)", "joystick", "state"],
  ["Experiment", "joystick", "application"],
  ["Gateway in space (OBC)", "space_gateway", "state"],
  ["Gateway on the ground (OGC)", "ground_gateway", "state"],
  ["Robot", "robot", "mode"],
  ["Robot's error", "robot", "error_kind"],
  ["Partner's robot", "robot", "partner"],
  ["Panel", "panel", "mode"],
  ["Tasks", "tasks", "phase"],
];
const TICK_MS = 500;
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
      for (const { row, value, age, application, parameter } of rows) {
        const said = systemSays(telemetry, application, parameter, connection.nowUs());
        // Most sessions have no partner's robot.
        row.hidden = said === null || (parameter === "partner" && said.text === "none");
        if (said === null) continue;
        setText(value, nameText(said.text));
        setAttribute(value, "data-level", said.level);
        setAttribute(row, "data-old", said.past ? "true" : null);
        setText(age, said.age === null ? "never" : agoText(said.age));
      }
    };
    connection.on("state", show);
    telemetry.onchange = show;
    setInterval(show, TICK_MS);
  }
}

customElements.define("systems-panel", SystemsPanel);

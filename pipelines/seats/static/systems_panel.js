/**
 * `<systems-panel>`: the state of each system in one line: joystick, gateways, robot, tasks. A
 * system that was not heard of lately, or that is beyond a lost link, is marked.
 *
 * @import { Seat } from "./seat.js"
 */
import { make, setAttribute, setText } from "./dom.js";
import { Telemetry, systemSays } from "./telemetry.js";
import { agoText, nameText, radioSays } from "./wording.js";

/** Name, application, parameter. @type {[string, string, string][]} */
const SYSTEMS = [
  ["Joystick (RJo)", "joystick", "state"],
  ["Experiment", "joystick", "application"],
  ["Gateway in space (OBC)", "space_gateway", "state"],
  ["Gateway on the ground (OGC)", "ground_gateway", "state"],
  ["Robot", "robot", "mode"],
  ["Robot's error", "robot", "error_kind"],
  ["Partner's robot", "robot", "partner"],
  ["K2CP (PCC)", "k2cp", "state"],
  ["Panel", "panel", "mode"],
  ["Tasks", "tasks", "phase"],
];
const TICK_MS = 500;
class SystemsPanel extends HTMLElement {
  /** @param {Seat} seat */
  follow({ connection, figures }) {
    const telemetry = new Telemetry(connection);
    const list = make("dl", { class: "systems" });
    const rows = SYSTEMS.map(([name, application, parameter]) => {
      const value = make("dd", { class: "system-value" }, "–");
      const age = make("dd", { class: "number quiet small" });
      const row = make("div", { "data-system": `${application}.${parameter}`, hidden: true }, make("dt", {}, name), value, age);
      list.append(row);
      return { row, value, age, application, parameter };
    });
    // The ground's antenna control: here the radio stands for it.
    const radio = make("dd", { class: "system-value" }, "–");
    const radioRow = make("div", { "data-system": "radio", hidden: true }, make("dt", {}, "Radio (CUP)"), radio);
    list.append(radioRow);
    this.append(make("header", {}, make("h2", {}, "Systems")), list);
    const show = () => {
      const carried = connection.alive ? radioSays(figures) : null;
      radioRow.hidden = carried === null;
      if (carried !== null) {
        setText(radio, carried.text);
        setAttribute(radio, "data-level", carried.level);
      }
      for (const { row, value, age, application, parameter } of rows) {
        const said = systemSays(telemetry, application, parameter, connection.nowUs());
        // Most sessions have no partner's robot.
        row.hidden = said === null || (parameter === "partner" && said.text === "none");
        if (said === null) continue;
        setText(value, parameter === "partner" && said.text === "driven" ? partnerSays(telemetry) : nameText(said.text));
        setAttribute(value, "data-level", said.level);
        setAttribute(row, "data-old", said.past ? "true" : null);
        setText(age, said.age === null ? "never" : agoText(said.age));
      }
    };
    for (const kind of /** @type {const} */ (["state", "figures", "lost"])) connection.on(kind, show);
    telemetry.onchange = show;
    setInterval(show, TICK_MS);
  }
}

/** What is known of the partner's robot while it is driven. @param {Telemetry} telemetry */
function partnerSays(telemetry) {
  const [force, age] = ["partner_force", "partner_age"].map((name) => telemetry.get("robot", name)?.value);
  if (typeof force !== "number" || typeof age !== "number") return "Driven";
  return `Driven: ${force.toFixed(1)} N, its answer ${age} ms old`;
}

customElements.define("systems-panel", SystemsPanel);

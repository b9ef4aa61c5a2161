/**
 * `<parameter-table>`: every parameter of telemetry with value, unit and age, in the colour of its
 * limit. With `application`, only those of that one. What is old is marked as such.
 *
 * @import { Seat } from "./seat.js"
 */
import { make, setAttribute, setText } from "./dom.js";
import { Telemetry, ageS, valueText } from "./telemetry.js";
import { agoText, nameText } from "./wording.js";

/** @type {Record<string, string>} */
const SIGNS = { good: "●", warn: "▲", bad: "✕", none: "" };
const TICK_MS = 500;

/**
 * @typedef {object} Row
 * @property {HTMLTableRowElement} row
 * @property {HTMLElement} value
 * @property {HTMLElement} limit
 * @property {HTMLElement} age
 */

class ParameterTable extends HTMLElement {
  /** By "APPLICATION.NAME". @type {Map<string, Row>} */
  #rows = new Map();
  #body = make("div", { class: "parameter-groups" });
  /** @type {Telemetry | null} */
  #telemetry = null;
  /** @type {Seat | null} */
  #seat = null;

  /** @param {Seat} seat */
  follow(seat) {
    this.#seat = seat;
    const telemetry = new Telemetry(seat.connection);
    this.#telemetry = telemetry;
    this.append(this.#body);
    telemetry.onchange = () => this.#show();
    seat.connection.on("hello", () => this.#build());
    // Ages grow also while nothing comes.
    setInterval(() => this.#show(), TICK_MS);
  }

  #build() {
    this.#rows.clear();
    const only = this.getAttribute("application");
    const applications = (this.#telemetry?.applications ?? []).filter(
      ({ name, parameters }) => parameters.length > 0 && (only === null || only === name),
    );
    this.#body.replaceChildren(
      ...applications.map(({ name, end, text, parameters }) => {
        const body = make("tbody");
        for (const parameter of parameters) {
          const value = make("td", { class: "number value" }, "–");
          const limit = make("td", { class: "limit small" });
          const age = make("td", { class: "number quiet small" }, "–");
          const cells = [
            make("th", { scope: "row", title: parameter.text }, nameText(parameter.name)),
            value,
            make("td", { class: "unit" }, parameter.unit.replace("octet", "byte")),
            limit,
            age,
          ];
          const row = make("tr", { "data-parameter": `${name}.${parameter.name}` }, ...cells);
          this.#rows.set(`${name}.${parameter.name}`, { row, value, limit, age });
          body.append(row);
        }
        const heading = make("h3", { title: text }, nameText(name), make("span", { class: "quiet small" }, ` ${end}`));
        const head = make("tr", {}, ...["", "value", "", "limit", "age"].map((word) => make("th", { scope: "col" }, word)));
        return make("section", {}, heading, make("table", { class: "parameters" }, make("thead", {}, head), body));
      }),
    );
    this.#show();
  }

  #show() {
    const nowUs = this.#seat?.connection.nowUs() ?? null;
    for (const { application, parameter, structure, value } of this.#telemetry?.entries() ?? []) {
      const row = this.#rows.get(`${application.name}.${parameter.name}`);
      if (row === undefined) continue;
      const age = ageS(value, nowUs);
      // What only functions are given has no value.
      const given = structure === null && application.functions.some((one) => one.arguments.includes(parameter.name));
      row.row.hidden = given && value === null;
      const past = this.#telemetry?.isPast(application, structure, age) ?? true;
      const level = past ? "none" : (value?.level ?? "none");
      setText(row.value, valueText(value?.value));
      setAttribute(row.value, "data-level", level);
      setText(row.limit, limitText(parameter.low, parameter.high, SIGNS[level] ?? ""));
      setAttribute(row.limit, "data-level", level);
      setText(row.age, age === null ? "never" : agoText(age));
      setAttribute(row.row, "data-old", past ? "true" : null);
    }
  }
}

/** @param {number | null} low @param {number | null} high @param {string} sign */
function limitText(low, high, sign) {
  if (low === null && high === null) return "";
  const range = low === null ? `≤ ${high}` : high === null ? `≥ ${low}` : `${low} … ${high}`;
  return `${sign} ${range}`;
}

customElements.define("parameter-table", ParameterTable);

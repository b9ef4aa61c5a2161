/**
 * `<parameter-table>`: every parameter of telemetry with value, unit and age, in the colour of its
 * limit. With `application`, only those of that one. What is old is marked as such. Parameters that
 * never came are one row, which says how many, until a person opens it.
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

/** What opens and closes an application's parameters that never came. @typedef {{row: HTMLTableRowElement, button: HTMLButtonElement, count: number}} Fold */

class ParameterTable extends HTMLElement {
  /** By "APPLICATION.NAME". @type {Map<string, Row>} */
  #rows = new Map();
  /** By application. @type {Map<string, Fold>} */
  #folds = new Map();
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
    this.#folds.clear();
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
        body.append(this.#fold(name));
        const heading = make("h3", { title: text }, nameText(name), make("span", { class: "quiet small" }, ` ${end}`));
        const head = make("tr", {}, ...["", "value", "", "limit", "age"].map((word) => make("th", { scope: "col" }, word)));
        return make("section", {}, heading, make("table", { class: "parameters" }, make("thead", {}, head), body));
      }),
    );
    this.#show();
  }

  /** @param {string} application */
  #fold(application) {
    const button = make("button", { type: "button", class: "fold small quiet", "aria-expanded": "false" });
    button.addEventListener("click", () => {
      button.setAttribute("aria-expanded", String(button.ariaExpanded !== "true"));
      this.#show();
    });
    const row = make("tr", {}, make("td", { colspan: "5" }, button));
    this.#folds.set(application, { row, button, count: 0 });
    return row;
  }

  #show() {
    for (const fold of this.#folds.values()) fold.count = 0;
    const nowUs = this.#seat?.connection.nowUs() ?? null;
    for (const { application, parameter, structure, value } of this.#telemetry?.entries() ?? []) {
      const row = this.#rows.get(`${application.name}.${parameter.name}`);
      if (row === undefined) continue;
      const age = ageS(value, nowUs);
      // What only functions are given has no value.
      const given = structure === null && application.functions.some((one) => one.arguments.includes(parameter.name));
      const fold = this.#folds.get(application.name);
      if (fold !== undefined && !given && value === null) fold.count += 1;
      row.row.hidden = value === null && (given || fold?.button.ariaExpanded !== "true");
      const past = this.#telemetry?.isPast(application, structure, age) ?? true;
      const level = past ? "none" : (value?.level ?? "none");
      setText(row.value, valueText(value?.value));
      setAttribute(row.value, "data-level", level);
      setText(row.limit, limitText(parameter.low, parameter.high, SIGNS[level] ?? ""));
      setAttribute(row.limit, "data-level", level);
      setText(row.age, age === null ? "never" : agoText(age));
      setAttribute(row.row, "data-old", past ? "true" : null);
    }
    for (const { row, button, count } of this.#folds.values()) {
      row.hidden = count === 0;
      setText(button, `${button.ariaExpanded === "true" ? "▾" : "▸"} ${count} not received yet`);
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

/**
 * The newest values of telemetry, for all elements that show some.
 *
 * @import { Connection } from "./connection.js"
 * @import { ApplicationText, Figure, ParameterText, StructureText, ValueText } from "./texts.js"
 */

/** Reports in a row that may be missing before a value counts as old. */
const MISSED = 2.5;

/**
 * A parameter and what is known of it.
 * @typedef {object} Entry
 * @property {ApplicationText} application
 * @property {ParameterText} parameter
 * @property {StructureText | null} structure The report that brings it.
 * @property {ValueText | null} value
 */

export class Telemetry {
  /** By "APPLICATION.NAME". @type {Map<string, ValueText>} */
  #values = new Map();
  /** @type {ApplicationText[]} */
  applications = [];
  onchange = () => {};

  /** @param {Connection} connection */
  constructor(connection) {
    connection.on("hello", ({ applications }) => {
      this.applications = applications;
      this.#values.clear();
      this.onchange();
    });
    connection.on("values", ({ values }) => {
      for (const value of values) this.#values.set(`${value.application}.${value.name}`, value);
      this.onchange();
    });
  }

  /** @param {string} application @param {string} name */
  get(application, name) {
    return this.#values.get(`${application}.${name}`) ?? null;
  }

  /** Every parameter of the dictionary. @returns {Entry[]} */
  entries() {
    return this.applications.flatMap((application) =>
      application.parameters.map((parameter) => ({
        application,
        parameter,
        structure: application.structures.find((one) => one.parameters.includes(parameter.name)) ?? null,
        value: this.get(application.name, parameter.name),
      })),
    );
  }
}

/** A value's age in seconds; null without one. @param {ValueText | null} value @param {number | null} nowUs */
export function ageS(value, nowUs) {
  return value === null || nowUs === null ? null : Math.max(0, (nowUs - value.at_us) / 1e6);
}

/** Whether a value must not be taken for the present. @param {number | null} age @param {number} intervalS */
export function isOld(age, intervalS) {
  return age === null || age > Math.max(MISSED * intervalS, 3);
}

/** A value as people read it. @param {Figure | undefined} value */
export function valueText(value) {
  if (value === null || value === undefined) return "–";
  if (typeof value === "boolean") return value ? "yes" : "no";
  if (typeof value !== "number") return value;
  return Number.isInteger(value) ? String(value) : String(Number(value.toPrecision(5)));
}

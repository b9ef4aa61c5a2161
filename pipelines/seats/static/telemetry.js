/**
 * The newest values of telemetry, for all elements that show some. What this end knows of its own
 * parts at once takes the place of their telemetry.
 *
 * @import { Connection } from "./connection.js"
 * @import { ApplicationText, Figure, Level, ParameterText, StructureText, ValueText } from "./texts.js"
 */
import { hindranceOf, ownValues } from "./conditions.js";
import { nameText } from "./wording.js";

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
  #connection;
  /** By "APPLICATION.NAME". @type {Map<string, ValueText>} */
  #values = new Map();
  /** @type {ApplicationText[]} */
  applications = [];
  onchange = () => {};

  /** @param {Connection} connection */
  constructor(connection) {
    this.#connection = connection;
    connection.on("hello", ({ applications }) => {
      this.applications = applications;
      this.#values.clear();
      this.onchange();
    });
    connection.on("values", ({ values }) => {
      for (const value of values) this.#values.set(`${value.application}.${value.name}`, value);
      this.onchange();
    });
    connection.on("lost", () => this.onchange());
  }

  /** @param {string} application @param {string} name @returns {ValueText | null} */
  get(application, name) {
    const key = `${application}.${name}`;
    const value = ownValues(this.#connection)[key];
    if (value === undefined) return this.#values.get(key) ?? null;
    const at_us = this.#connection.state?.now_us ?? 0;
    return { application, name, value, level: "none", at_us };
  }

  /**
   * Whether a value must not be taken for the present: it is old, or nothing comes from its end. Of a
   * session that was stopped nothing runs at this end either.
   * @param {ApplicationText} application @param {StructureText | null} structure @param {number | null} age In s.
   */
  isPast({ end }, structure, age) {
    const { alive, stopped, hello } = this.#connection;
    const away = end !== hello?.seat && hindranceOf(this.#connection) !== "";
    return !alive || stopped || away || isOld(age, structure?.interval_s ?? Infinity);
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

/** By value of a state: how good it is. @type {Record<string, Level>} */
const LEVELS = {
  connected: "good",
  application: "good",
  telepresence: "good",
  "german experiment": "good",
  "russian experiment": "good",
  driven: "good",
  open: "good",
  "no page": "warn",
  halted: "warn",
  off: "warn",
  lost: "bad",
  refused: "bad",
  "recoverable error": "bad",
  "fatal error": "bad",
  "calibration error": "bad",
  workspace: "bad",
  force: "bad",
  speed: "bad",
  other: "bad",
};

/**
 * What is beyond a limit or in a bad state now, the worst first, in words.
 * @param {Telemetry} telemetry @param {number | null} nowUs
 */
export function alarmsOf(telemetry, nowUs) {
  const found = telemetry.entries().flatMap(({ application, parameter, structure, value }) => {
    if (value === null || telemetry.isPast(application, structure, ageS(value, nowUs))) return [];
    const text = valueText(value.value);
    const level = value.level === "none" || value.level === "good" ? (LEVELS[text] ?? "none") : value.level;
    if (level !== "warn" && level !== "bad") return [];
    const words = `${nameText(application.name)}: ${nameText(parameter.name)} ${text} ${parameter.unit ?? ""}`;
    return [{ level, words: words.trim() }];
  });
  return found.toSorted((one, other) => Number(other.level === "bad") - Number(one.level === "bad"));
}

/**
 * What a row says; null: the session has no such part.
 * @param {Telemetry} telemetry @param {string} application @param {string} parameter @param {number | null} nowUs
 */
export function systemSays(telemetry, application, parameter, nowUs) {
  const known = telemetry.applications.find(({ name }) => name === application);
  if (!known?.parameters.some(({ name }) => name === parameter)) return null;
  const newest = telemetry.get(application, parameter);
  const structure = known.structures.find(({ parameters }) => parameters.includes(parameter)) ?? null;
  const age = ageS(newest, nowUs);
  const past = telemetry.isPast(known, structure, age);
  // Its mode is that of the next power on.
  const off = parameter === "mode" && telemetry.get("robot", "powered")?.value === false && application === "robot";
  const text = off ? "off" : valueText(newest?.value);
  return { text, age, past, level: past ? "none" : (LEVELS[text] ?? "none") };
}

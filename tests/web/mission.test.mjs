/** How the mission's pages read telemetry. */
import assert from "node:assert/strict";
import { test } from "node:test";
import { load } from "./modules.mjs";

const { Telemetry, ageS, alarmsOf, isOld, valueText } = await load("telemetry.js");
const { agoText } = await load("wording.js");

const value = (at_us, known = 1) => ({ application: "a", name: "x", value: known, level: "good", at_us });

/** A connection that only tells. */
class Told {
  hello = null;
  #listeners = {};
  on(name, listener) {
    this.#listeners[name] = listener;
  }
  tell(name, event) {
    this.#listeners[name](event);
  }
}

test("a value is old after two and a half of its reports, at least three seconds", () => {
  const age = (seconds) => ageS(value(0), seconds * 1e6);
  assert.deepEqual([age(2.9), age(3.1)].map((one) => isOld(one, 1)), [false, true]);
  assert.deepEqual([age(24), age(26)].map((one) => isOld(one, 10)), [false, true]);
  assert.equal(isOld(ageS(null, 0), 1), true);
});

test("values are read as they are, and nothing stands for what is no number", () => {
  assert.deepEqual([0.0123456, 7, true, "halted", null, undefined].map(valueText), ["0.012346", "7", "yes", "halted", "–", "–"]);
  assert.deepEqual([0.24, 12.2, 125, null].map(agoText), ["0.2 s", "12 s", "02:05", "–"]);
});

test("alarms are what is beyond a limit or in a bad state now, the worst first", () => {
  const told = new Told();
  const telemetry = new Telemetry(told);
  const parameters = ["heat", "state", "place"].map((name) => ({ name, unit: name === "heat" ? "degC" : "" }));
  const structures = [{ name: "all", parameters: parameters.map(({ name }) => name), interval_s: 1, on: true }];
  const applications = [{ name: "joystick", end: "ground", parameters, structures, functions: [] }];
  Object.assign(told, { alive: true, hello: { seat: "ground" }, state: null, robot: null });
  told.tell("hello", { applications });
  const values = [
    ["heat", 61, "warn"],
    ["state", "fatal error", "none"],
    ["place", 0, "good"],
  ].map(([name, known, level]) => ({ application: "joystick", name, value: known, level, at_us: 1e6 }));
  told.tell("values", { values });
  const words = (nowUs) => alarmsOf(telemetry, nowUs).map(({ level, words: text }) => `${level} ${text}`);
  assert.deepEqual(words(2e6), ["bad joystick: state fatal error", "warn joystick: heat 61 degC"]);
  // What was heard long ago is no alarm of now.
  assert.deepEqual(words(9e6), []);
});

test("another session's values are forgotten, and each parameter has its report", () => {
  const told = new Told();
  const telemetry = new Telemetry(told);
  const parameters = [{ name: "x" }, { name: "y" }];
  const structures = [{ name: "state", parameters: ["x"], interval_s: 1, on: true }];
  const hello = { applications: [{ name: "a", parameters, structures, functions: [] }] };
  told.tell("hello", hello);
  told.tell("values", { values: [value(5)] });
  const [x, y] = telemetry.entries();
  assert.equal(x.value.at_us, 5);
  assert.equal(x.structure.name, "state");
  assert.deepEqual([y.value, y.structure], [null, null]);
  told.tell("hello", hello);
  assert.equal(telemetry.get("a", "x"), null);
});

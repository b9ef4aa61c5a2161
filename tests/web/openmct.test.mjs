// The sample for Open MCT against answers of YAMCS 5.12.

import assert from "node:assert/strict";
import { test } from "node:test";
import { row, yamcs } from "../../samples/openmct/yamcs.mjs";

const FLOAT = { engType: "float", unitSet: [{ unit: "N" }] };
const STATE = { engType: "enumeration", enumValues: [{ value: "3", label: "application" }] };
const PARAMETERS = [
  { name: "joystick_state", qualifiedName: "/kontur_av/joystick_state", type: STATE },
  { name: "force", qualifiedName: "/kontur_av/force", type: FLOAT },
  { name: "cpu", qualifiedName: "/yamcs/host/cpu", type: FLOAT },
];

/** A value as YAMCS tells it. */
function told(name, second, engValue) {
  const generationTime = `2026-01-01T00:00:0${second}Z`;
  return { id: { name: `/kontur_av/${name}` }, generationTime, engValue };
}

/** The plug-in in an Open MCT that keeps what it is given; `answers` by the path's beginning. */
function installed(answers) {
  const asked = [];
  const kept = { telemetry: [], roots: [] };
  yamcs(async (path, request) => {
    asked.push(path);
    const found = Object.keys(answers).find((begin) => path.startsWith(begin));
    return { ok: found !== undefined, status: 404, json: async () => answers[found](request) };
  })({
    types: { addType: () => {} },
    objects: {
      addRoot: (root) => kept.roots.push(root),
      addProvider: (_, provider) => (kept.objects = provider),
    },
    composition: { addProvider: (provider) => (kept.composition = provider) },
    telemetry: { addProvider: (provider) => kept.telemetry.push(provider) },
  });
  return { ...kept, asked };
}

test("parameters of the session are objects with units and enumerations", async (context) => {
  context.mock.timers.enable({ apis: ["setTimeout"] });
  const { objects, composition, roots } = installed({
    "/api/mdb/": () => ({ parameters: PARAMETERS }),
  });
  const folder = await objects.get(roots[0]);
  assert.ok(composition.appliesTo(folder));
  const found = await composition.load();
  assert.deepEqual(found.map((one) => one.key), ["force", "joystick_state"]);
  const [force, state] = await Promise.all(found.map(objects.get));
  assert.equal(force.telemetry.values[1].unit, "N");
  assert.deepEqual(state.telemetry.values[1].enumerations, [{ value: 3, string: "application" }]);
  assert.ok(!composition.appliesTo(force));
});

test("values come as numbers, oldest first, and a new one once", async (context) => {
  context.mock.timers.enable({ apis: ["setTimeout"] });
  let second = 1;
  const force = () => told("force", second, { type: "DOUBLE", doubleValue: 1.5 });
  const { telemetry, asked } = installed({
    "/api/mdb/": () => ({ parameters: PARAMETERS }),
    "/api/archive/": () => ({ parameter: [force(), told("force", 0, { type: "DOUBLE", doubleValue: 1 })] }),
    "/api/processors/": (request) => {
      assert.deepEqual(JSON.parse(request.body).id, [{ name: "/kontur_av/force" }]);
      return { value: [force()] };
    },
  });
  const object = { identifier: { key: "force" }, type: "yamcs.parameter" };
  const older = telemetry.find((one) => one.supportsRequest?.(object));
  const rows = await older.request(object, { start: 0, end: 1000 });
  assert.deepEqual(rows.map((one) => one.value), [1, 1.5]);
  assert.match(asked.at(-1), /start=1970-01-01T00:00:00.000Z&stop=1970-01-01T00:00:01.000Z/);

  const came = [];
  const newer = telemetry.find((one) => one.supportsSubscribe?.(object));
  const leave = newer.subscribe(object, (one) => came.push(one.utc));
  for (second of [1, 1, 2]) await polled(context);
  leave();
  second = 3;
  await polled(context);
  assert.deepEqual(came.map((utc) => new Date(utc).getUTCSeconds()), [1, 2]);
});

/** Let one poll pass. */
async function polled(context) {
  for (let turn = 0; turn < 8; turn++) await new Promise(setImmediate);
  context.mock.timers.tick(500);
  for (let turn = 0; turn < 8; turn++) await new Promise(setImmediate);
}

test("an enumeration is its number, a text itself", () => {
  const state = told("joystick_state", 1, { type: "ENUMERATED", stringValue: "application" });
  assert.equal(row(state, STATE).value, 3);
  assert.equal(row(told("x", 1, { type: "SINT64", sint64Value: "-4" }), {}).value, -4);
  assert.equal(row(told("x", 1, { type: "STRING", stringValue: "on" }), {}).value, "on");
});

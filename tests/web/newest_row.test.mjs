/** What is known of place and force now: the newest row of its own end, as long as it is fresh. */
import assert from "node:assert/strict";
import { test } from "node:test";
import { Line, clockMs, haptics, pass } from "./page.mjs";
import { load } from "./modules.mjs";

const { NewestRow } = await load("newest_row.js");
const { FULL_N, drawArrow, forceShare } = await load("force_view.js");
const { Drawn } = await import("./page.mjs");

test("the newest row is that of its own end, and nothing is known of one that is old", () => {
  const line = new Line();
  const newest = new NewestRow(line, "robot");
  line.tell("haptic", haptics("joystick", 1, 1));
  assert.equal(newest.row, null);
  line.tell("haptic", haptics("robot", 0.01, 0.02, 3, -4, 1 | (3 << 16)));
  assert.deepEqual([newest.row.contact, newest.row.deadMan, newest.row.lit], [true, false, 2]);
  assert.equal(newest.forceN, 5);
  pass(300 - (clockMs() % 300));
  line.tell("haptic", haptics("robot", 0.01, 0.02, 3, -4));
  pass(300);
  assert.notEqual(newest.row, null);
  pass(300);
  assert.deepEqual([newest.row, newest.forceN], [null, null]);
});

test("only a change that a person could see is told", () => {
  const line = new Line();
  const newest = new NewestRow(line, "robot");
  let changes = 0;
  newest.onchange = () => (changes += 1);
  for (let step = 0; step < 20; step += 1) line.tell("haptic", haptics("robot", 1e-6 * step, 0));
  assert.equal(changes, 1);
  line.tell("haptic", haptics("robot", 0.001, 0));
  line.tell("haptic", haptics("robot", 0.001, 0, 0.1));
  line.tell("haptic", haptics("robot", 0.001, 0, 0.1, 0, 2));
  assert.equal(changes, 4);
});

test("a bar is full at the most force, and an arrow ends where the force points", () => {
  assert.deepEqual([0, FULL_N / 2, FULL_N, 9 * FULL_N].map(forceShare), [0, 0.5, 1, 1]);
  const context = new Drawn();
  drawArrow(context, 0, 0, 0.5, 0, 4);
  assert.deepEqual(context.of("moveTo"), []);
  drawArrow(context, 10, 20, 30, 40, 4);
  const [from, tip] = context.of("moveTo");
  assert.deepEqual([from, tip], [[10, 20], [40, 60]]);
  // Both barbs are as far from the tip.
  const [, left, right] = context.of("lineTo");
  const far = ([x, y]) => Math.hypot(40 - x, 60 - y);
  assert.ok(Math.abs(far(left) - far(right)) < 1e-9);
});

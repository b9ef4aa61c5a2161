/** When charts and tiles are drawn: not more often than a person can see, and only in sight. */
import assert from "node:assert/strict";
import { test } from "node:test";
import { Element, look, pass } from "./page.mjs";
import { load } from "./modules.mjs";

const { drawOften } = await load("drawing_loop.js");
const { onNextFrame } = await load("next_frame.js");

test("charts in sight are drawn at most 15 times a second, others not at all", () => {
  const [one, other] = [new Element(), new Element()];
  const counts = [0, 0];
  drawOften(one, () => (counts[0] += 1));
  drawOften(other, () => (counts[1] += 1));
  pass(1000);
  assert.deepEqual(counts, [0, 0]);
  look(one, { isIntersecting: true });
  pass(2000);
  assert.ok(counts[0] > 25 && counts[0] <= 30, String(counts[0]));
  look(one, { isIntersecting: false });
  look(other, { isIntersecting: true });
  const [before] = counts;
  pass(1000);
  assert.deepEqual([counts[0], counts[1] > 10], [before, true]);
});

test("many changes before a frame are drawn once", () => {
  let draws = 0;
  const change = onNextFrame(() => (draws += 1));
  for (let frame = 1; frame < 4; frame += 1) {
    for (let turn = 0; turn < 5; turn += 1) change();
    assert.equal(draws, frame - 1);
    pass(20);
    assert.equal(draws, frame);
  }
  pass(1000);
  assert.equal(draws, 3);
});

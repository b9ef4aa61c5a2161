/** The silence of the server, as a worker counts it. */
import assert from "node:assert/strict";
import { test } from "node:test";
import { load } from "./modules.mjs";

const { Silence } = await load("silence.js");

/** Looks every 25 ms and returns the silence at the end. */
function look(silence, fromMs, toMs) {
  let silentMs = 0;
  for (let ms = fromMs; ms <= toMs; ms += 25) silentMs = silence.look(ms);
  return silentMs;
}

test("a silence grows with the time until something is heard", () => {
  const silence = new Silence();
  silence.look(0);
  silence.handleHeard();
  assert.equal(look(silence, 25, 300), 300);
  silence.handleHeard();
  assert.equal(look(silence, 325, 350), 50);
});

test("time in which the worker was blocked is no silence of the server", () => {
  const silence = new Silence();
  silence.look(0);
  silence.handleHeard();
  assert.ok(silence.look(2000) <= 50);
  assert.ok(look(silence, 2025, 2125) < 250);
  assert.ok(look(silence, 2150, 2400) > 250);
});

/** What ground control's charts keep: no peak, gap or short loss may vanish. */
import assert from "node:assert/strict";
import { test } from "node:test";
import { load } from "./modules.mjs";

const { ColumnStore } = await load("column_store.js");
const { HapticTrace } = await load("haptic_trace.js");
const { LAYERS, OctetHistory } = await load("octet_history.js");
const { CONNECTED, NO_SIGNAL, SignalHistory, UNKNOWN } = await load("signal_history.js");

test("a column has the peak of one sample among many", () => {
  const store = new ColumnStore(10, 20_000, 1);
  for (let ms = 0; ms < 60; ms += 1) store.add(0, 1000 * ms, ms === 33 ? 9 : ms === 34 ? -7 : 0);
  const place = store.placeOf(0, 1);
  assert.deepEqual([store.least[place], store.greatest[place]], [-7, 9]);
  assert.equal(store.reach([0], 0, 2), 9);
  assert.equal(store.reach([0], 2, 2), 0);
});

test("a column in which nothing came, or that was overwritten, has no place", () => {
  const store = new ColumnStore(4, 1000, 2);
  store.add(0, 500, 1);
  store.add(0, 2500, 1);
  assert.equal(store.placeOf(0, 1), -1);
  assert.equal(store.placeOf(1, 0), -1);
  store.add(0, 4500, 1);
  assert.equal(store.placeOf(0, 0), -1);
  assert.notEqual(store.placeOf(0, 4), -1);
});

test("a late sample says from which column on to draw anew, and a too late one changes nothing", () => {
  const store = new ColumnStore(4, 1000, 1);
  for (const column of [5, 6, 7]) store.add(0, 1000 * column, 1);
  store.taken();
  store.add(0, 6000, 3);
  assert.equal(store.changedFrom, 6);
  store.add(0, 2000, 50);
  assert.equal(store.reach([0], 0, 9), 3);
});

test("a trace keeps the newest rows", () => {
  const trace = new HapticTrace(3);
  const column = (start) => Float32Array.from([start, start + 1]);
  for (const start of [0, 2, 4]) {
    const columns = [0, 10, 20, 30].map((offset) => column(start + offset));
    trace.append({ end: "robot", rows: 2, timeUs: Float64Array.from([start, start + 1]), columns });
  }
  assert.equal(trace.oldest, 3);
  const kept = [3, 4, 5].map((row) => trace.values[3][row % 3]);
  assert.deepEqual(kept, [33, 34, 35]);
  assert.equal(trace.timesUs[trace.newest], 5);
});

test("rates are differences of counts; unknown carriers are counted too, idle fill is apart", () => {
  const history = new OctetHistory(8);
  history.append(0, { video: 1000, header: 0, fecf: 5, novel: 0, idle: 0 });
  assert.equal(history.appended, 0);
  history.append(500_000, { video: 2000, header: 50, fecf: 55, novel: 25, idle: 700 });
  const layer = (name) => LAYERS.findIndex(({ parts }) => parts.includes(name));
  assert.equal(history.rate(0, layer("video")), 16_000);
  assert.equal(history.rate(0, layer("header")), 2000);
  assert.equal(history.total(0), 18_000);
  assert.equal(history.idleBps, 11_200);
});

test("there is no rate across a pause or a count that began anew", () => {
  const history = new OctetHistory(8);
  history.append(0, { video: 0 });
  history.append(5_000_000, { video: 1000 });
  history.append(5_500_000, { video: 10 });
  history.append(6_000_000, { video: 20 });
  assert.ok(Number.isNaN(history.total(0)) && Number.isNaN(history.total(1)));
  assert.equal(history.total(2), 160);
});

test("the band keeps a short loss, and knows nothing of a time without a server", () => {
  const history = new SignalHistory(50);
  const at = (ms, signal) => history.append(1000 * ms, signal, signal);
  for (const [ms, signal] of [[0, true], [100, true], [150, false], [190, true], [400, true], [2000, true]]) at(ms, signal);
  const states = (nowMs, back) => history.at(1000 * nowMs, back);
  assert.equal(states(2000, 19), NO_SIGNAL);
  // Two steps without a state are jitter.
  assert.equal(states(2000, 17), CONNECTED);
  assert.equal(states(2000, 10), UNKNOWN);
  assert.equal(states(2000, 0), CONNECTED);
  assert.equal(states(2300, 0), UNKNOWN);
  assert.equal(states(99_000, 0), UNKNOWN);
});

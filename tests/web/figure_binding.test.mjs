/** Figures in the elements that ask for them, and in words. */
import assert from "node:assert/strict";
import { test } from "node:test";
import { Element, Line, paper } from "./page.mjs";
import { load } from "./modules.mjs";

const { FigureBinding, NOTHING } = await load("figure_binding.js");
const { pathSays } = await load("path_list.js");
const words = await load("wording.js");

test("a figure is written wherever it is asked for, and a word stays a word", () => {
  const bare = new Element({ "data-figure": "a" });
  const scaled = new Element({ "data-figure-in": "a", "data-scale": "0.001", "data-decimals": "2" });
  const other = new Element({ "data-figure": "b" });
  const figures = new FigureBinding({ querySelectorAll: () => [bare, scaled, other] });
  assert.deepEqual([bare, scaled, other].map((one) => one.textContent), [NOTHING, NOTHING, NOTHING]);
  const line = new Line();
  figures.follow(line);
  const told = (a) => {
    line.tell("figures", { figures: { a, b: "connected" } });
    return [bare.textContent, scaled.textContent];
  };
  assert.deepEqual(told(12_345), ["12345", "12.35"]);
  assert.deepEqual(told(12.34), ["12.3", "0.01"]);
  assert.deepEqual(told(-0.01), ["0.0", "0.00"]);
  assert.deepEqual(told(null), [NOTHING, NOTHING]);
  assert.deepEqual(told(Infinity), [NOTHING, NOTHING]);
  assert.deepEqual([other.textContent, figures.get("b"), figures.number("b")], ["connected", "connected", null]);
});

test("what the page computes itself is not overwritten; new elements get what is known", () => {
  const figures = new FigureBinding(paper);
  const line = new Line();
  figures.follow(line);
  figures.setOwn("age", 7);
  line.tell("figures", { figures: { age: 99, rate: 5 } });
  assert.deepEqual([figures.number("age"), figures.number("rate"), figures.get("none")], [7, 5, null]);
  const late = new Element({ "data-figure": "age" });
  paper.found = [late];
  figures.refresh();
  assert.equal(late.textContent, "7");
  paper.found = [];
});

test("numbers have about three digits, and their unit grows with them", () => {
  const { agoText, clockText, countText, millisecondsText, nameText, rateText, wayText } = words;
  assert.deepEqual([0, 1234, 85_000, 999_499, 999_500, 12_345_678].map(rateText), ["0 kbit/s", "1.23 kbit/s", "85.0 kbit/s", "999 kbit/s", "1.00 Mbit/s", "12.3 Mbit/s"]);
  assert.deepEqual([9.994, 9.996, 9999, 10_000].map(millisecondsText), ["9.99 ms", "10.0 ms", "9999 ms", "10.0 s"]);
  assert.deepEqual([59.9, 3600, -61].map(clockText), ["00:59", "1:00:00", "−01:01"]);
  assert.deepEqual([9.94, 9.96, 99.4, 99.6].map(agoText), ["9.9 s", "10 s", "99 s", "01:39"]);
  assert.deepEqual([999, 1e6].map(countText), ["999", "1\u2009000\u2009000"]);
  assert.deepEqual([wayText(-0.0104, 0.002), wayText(0, -0.05), wayText(1e-4, 0)], ["10 mm left, 2 mm up", "50 mm down", ""]);
  assert.equal(nameText("uplink_video followContour"), "uplink video follow contour");
  for (const text of [agoText, clockText, countText, millisecondsText, rateText]) {
    assert.deepEqual([null, undefined, NaN, "7"].map(text), [NOTHING, NOTHING, NOTHING, NOTHING]);
  }
});

test("the path to another machine is in words, and nothing that was not measured", () => {
  const says = (peer) => pathSays({ get: (name) => peer[name.replace("gateways.space.peer.", "")] ?? null });
  const slow = { path_state: "lower caps", path_why: "records wait 80 ms", path_bps: 812_000, path_loss: 0.0123, video_cap_bps: 543_000, order_budget_ns: 12e6 };
  assert.equal(says({}), null);
  assert.deepEqual(says(slow), { peer: "ground", state: "lower caps", why: "records wait 80 ms", texts: ["812 kbit/s", "1.2 %", "543 kbit/s", "12.0 ms"] });
  assert.deepEqual(says({ path_state: "all", path_bps: 0 }), { peer: "ground", state: "not measured", why: "", texts: [NOTHING, NOTHING, NOTHING, NOTHING] });
});

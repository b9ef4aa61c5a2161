/** The hand in the page: who may press, where the handle begins, and all that must let it go. */
import assert from "node:assert/strict";
import { test } from "node:test";
import { Line, haptics, happen, paper, pass, settle } from "./page.mjs";
import { load } from "./modules.mjs";

const { HandControl } = await load("hand_control.js");
const you = { holder: 1, you: true, who: "operator" };

function held(changes = {}) {
  const line = new Line();
  Object.assign(line.state, { hand: you }, changes);
  const control = new HandControl(line);
  line.tell("haptic", haptics("joystick", 0.05, -0.05));
  assert.ok(control.press("pointer"));
  return { line, control };
}

test("a press begins where the handle is, and is told again and again until its release", () => {
  const { line, control } = held();
  assert.deepEqual(control.target, { x: 0.5, y: -1 });
  pass(100);
  assert.ok(line.hands.length >= 4);
  assert.ok(line.hands.every((hand) => hand.deadMan && hand.x === 0.5));
  control.release("keys");
  assert.equal(control.source, "pointer");
  control.release("pointer");
  const { length } = line.hands;
  assert.deepEqual(line.hands.at(-1), { deadMan: false, x: 0, y: 0, buttons: 0 });
  control.releaseAll();
  pass(1000);
  assert.equal(line.hands.length, length);
  assert.equal(control.target, null);
});

test("one thing at a time presses, and nothing moves the handle beyond its workspace", () => {
  const { line, control } = held();
  assert.equal(control.press("keys"), false);
  control.move("keys", 0, 0);
  assert.deepEqual(control.target, { x: 0.5, y: -1 });
  control.move("pointer", 7, -0.25);
  assert.deepEqual(control.target, { x: 1, y: -0.25 });
  control.setButtons(5);
  assert.deepEqual([line.hands.at(-1).x, line.hands.at(-1).buttons], [1, 5]);
  control.releaseAll();
});

test("axes behind x and y begin where they are", () => {
  const axes = [{ position: 0.1, half_range: 0.2 }, { position: 9, half_range: 1 }];
  const { line, control } = held({ joystick: { axes } });
  assert.deepEqual([0, 1, 2].map((axis) => control.axisTarget(axis)), [0.5, 1, null]);
  control.moveAxis(0, -3);
  control.moveAxis(2, 1);
  assert.deepEqual(line.hands.at(-1).more, [-1, 1]);
  control.releaseAll();
  assert.equal(control.axisTarget(0), null);
});

test("whatever takes the person away lets go, once", () => {
  const away = {
    blur: () => happen("blur"),
    pagehide: () => happen("pagehide"),
    hidden: () => {
      paper.hidden = true;
      paper.dispatchEvent(new Event("visibilitychange"));
      paper.hidden = false;
    },
    lost: (line) => line.tell("lost"),
    hello: (line) => line.tell("hello"),
    "let go": (line) => line.tell("let_go"),
    another: (line) => {
      pass(100);
      line.tell("state", { now_us: line.nowUs(), hand: { ...you, you: false } });
    },
  };
  for (const [name, act] of Object.entries(away)) {
    const { line, control } = held();
    act(line);
    assert.equal(control.source, null, name);
    assert.equal(line.hands.filter((hand) => !hand.deadMan).length, 1, name);
  }
  const { line, control } = held();
  // It was sent before the handle was taken.
  line.tell("state", { now_us: line.nowUs(), hand: { ...you, you: false } });
  assert.equal(control.source, "pointer");
  control.releaseAll();
});

test("a free handle is taken first; until the answer, and after a refusal, nothing is sent", async () => {
  const line = new Line();
  const control = new HandControl(line);
  assert.ok(control.press("keys"));
  assert.deepEqual([line.asked, line.hands], [[{ do: "hand", action: "take" }], []]);
  await settle();
  assert.equal(line.hands.at(-1).deadMan, true);
  control.releaseAll();

  line.answer = { ok: false, error: "it is taken" };
  const { length } = line.hands;
  control.press("keys");
  await settle();
  assert.deepEqual([control.source, control.refusal], [null, "it is taken"]);
  assert.ok(line.hands.slice(length).every((hand) => !hand.deadMan));

  // An answer that comes after the release presses nothing.
  line.answer = { ok: true, error: "" };
  control.press("keys");
  control.release("keys");
  const before = line.hands.length;
  await settle();
  pass(100);
  assert.equal(line.hands.length, before);
});

test("a press that cannot count says why", () => {
  const reasons = [
    [{ alive: false, hindrance: "the session is over." }, /the session is over\. Let go/],
    [{ hello: { joystick: "simulated" } }, /joystick "simulated" steers/],
    [{ mayAct: false }, /a viewer may watch only/],
    [{ state: { hand: { holder: 2, you: false, who: "cosmonaut" } } }, /cosmonaut has the handle/],
  ];
  for (const [changes, words] of reasons) {
    const line = Object.assign(new Line(), changes);
    const control = new HandControl(line);
    assert.equal(control.press("pointer"), false);
    assert.match(control.refusal, words);
    assert.deepEqual(line.hands, []);
  }
});

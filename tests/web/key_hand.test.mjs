/** Keys that steer, and when a key is no shortcut. */
import assert from "node:assert/strict";
import { test } from "node:test";
import { Element, happen, paper, pass } from "./page.mjs";
import { load } from "./modules.mjs";

const { Keyboard } = await load("keyboard.js");
const { steerByKeys } = await load("key_hand.js");

/** The handle as keys see it. */
class Control {
  source = null;
  target = null;
  refuses = false;
  press(source) {
    if (this.refuses) return false;
    [this.source, this.target] = [source, { x: 0, y: 0 }];
    return true;
  }
  move(_, x, y) {
    this.target = { x, y };
  }
  release() {
    [this.source, this.target] = [null, null];
  }
}

const control = new Control();
const keyboard = new Keyboard();
steerByKeys(keyboard, control, () => ({ x: 0.1, y: 0.05 }));

function key(name, code, fields = {}) {
  let prevented = false;
  happen(name, { code, key: code, target: new Element(), preventDefault: () => (prevented = true), ...fields });
  return prevented;
}
const down = (code, fields) => key("keydown", code, fields);
const up = (code) => key("keyup", code);

test("Space holds, arrows and letters move at one speed whatever the direction, Shift slowly", () => {
  down("KeyD");
  pass(400);
  assert.equal(control.target, null);
  down("Space");
  pass(400);
  // 0.1 m/s.
  assert.ok(Math.abs(control.target.x - 0.4) < 0.01);
  up("KeyD");
  const { x } = control.target;
  pass(400);
  assert.equal(control.target.x, x);
  down("ArrowUp");
  down("ArrowLeft");
  down("ShiftLeft");
  const from = control.target;
  pass(400);
  const way = Math.hypot((control.target.x - from.x) * 0.1, (control.target.y - from.y) * 0.05);
  assert.ok(Math.abs(way - 0.4 * 0.02) < 5e-4);
  assert.ok(control.target.x < from.x && control.target.y > from.y);
  up("Space");
  assert.equal(control.source, null);
  for (const code of ["ArrowUp", "ArrowLeft", "ShiftLeft"]) up(code);
});

test("a page that loses the focus releases what is held", () => {
  down("Space");
  assert.equal(control.source, "keys");
  happen("blur");
  assert.equal(control.source, null);
  down("Space");
  paper.hidden = true;
  paper.dispatchEvent(new Event("visibilitychange"));
  paper.hidden = false;
  assert.equal(control.source, null);
});

test("no key acts while a person types, with Ctrl, in a dialog, or again by its repeat", () => {
  const pressed = [];
  keyboard.add({ keys: ["p"], what: "something", down: (one) => pressed.push(one) });
  const typing = new Element({ of: "textarea" });
  assert.equal(down("KeyP", { key: "p", target: typing }), false);
  for (const held of ["ctrlKey", "altKey", "metaKey"]) down("KeyP", { key: "p", [held]: true });
  paper.querySelector = (selector) => (selector === "dialog[open]" ? {} : null);
  down("KeyP", { key: "p" });
  paper.querySelector = () => null;
  down("KeyP", { key: "p", repeat: true });
  assert.deepEqual(pressed, []);
  assert.equal(down("KeyP", { key: "P" }), true);
  assert.deepEqual(pressed, ["P"]);
  // Space belongs to the button that has the focus, an arrow to a slider.
  assert.equal(down("Space", { key: " ", target: new Element({ of: "button" }) }), false);
  assert.equal(down("ArrowUp", { target: new Element({ of: 'input[type="range"]' }) }), false);
  assert.equal(control.source, null);
});

test("a refused press moves nothing", () => {
  control.refuses = true;
  down("Space");
  down("ArrowUp");
  pass(200);
  assert.equal(control.target, null);
  up("Space");
  up("ArrowUp");
});

/** A game controller and a pointer that steer. */
import assert from "node:assert/strict";
import { test } from "node:test";
import { Element, Line, event, happen, haptics, hardware, paper, pass } from "./page.mjs";
import { load } from "./modules.mjs";

const { HandControl } = await load("hand_control.js");
const { holdsDeadMan, steerByController } = await load("controller_hand.js");
const { steerByPointer } = await load("pointer_hand.js");

function steered() {
  const line = new Line();
  line.state.hand = { holder: 1, you: true, who: "operator" };
  const control = new HandControl(line);
  line.tell("haptic", haptics("joystick", 0, 0));
  return { line, control };
}

const pad = () => ({
  connected: true,
  axes: [0.5, 0.25],
  buttons: Array.from({ length: 8 }, () => ({ value: 0, pressed: false })),
  shaken: [],
  get vibrationActuator() {
    return { playEffect: (_, how) => this.shaken.push(how) && Promise.resolve() };
  },
});

test("a trigger is the dead-man switch, the stick the place, and the motors show the force", () => {
  const { line, control } = steered();
  const one = pad();
  hardware.pads = [null, one];
  steerByController(control, () => 0.25);
  happen("gamepadconnected");
  pass(50);
  assert.equal(control.source, null);
  for (const index of [0, 1, 4, 5, 6, 7]) {
    one.buttons[index].value = 1;
    assert.equal(holdsDeadMan(one), index >= 4);
    one.buttons[index].value = 0;
  }
  one.buttons[7].value = 0.9;
  one.buttons[1].pressed = true;
  pass(500);
  assert.equal(control.source, "controller");
  assert.equal(line.hands.at(-1).buttons, 2);
  // Its y is down.
  assert.deepEqual(control.target, { x: 0.5, y: -0.25 });
  assert.ok(one.shaken.length >= 4 && one.shaken.length <= 7);
  assert.deepEqual([one.shaken[0].strongMagnitude, one.shaken[0].weakMagnitude], [0.25, 0.5]);
  one.buttons[7].value = 0.1;
  pass(20);
  assert.equal(control.source, null);
});

test("a session's map names the controls of all axes, of stop and of hand-over", () => {
  const { line, control } = steered();
  line.state.joystick = { axes: [{ name: "z", position: 0, half_range: 1 }] };
  const one = pad();
  hardware.pads = [one];
  const told = [];
  const plain = { axis: -1, up: -1, down: -1, scale: 1, dead_zone: 0, rate: false };
  const axes = [{ ...plain, name: "x", axis: 1, scale: -2, dead_zone: 0.125 }, { ...plain, name: "z", up: 5, down: 4, rate: true }];
  steerByController(control, () => 0, {
    mapping: () => ({ axes, dead_man: [6], stop: 0, hand_over: 1, panel: [3, 2] }),
    axes: () => ["z"],
    stop: () => told.push("stop"),
    handOver: () => told.push("over"),
  });
  happen("gamepadconnected");
  for (const index of [0, 1, 5, 6]) one.buttons[index].value = 1;
  one.buttons[2].pressed = true;
  pass(500);
  assert.deepEqual(told, ["stop", "over"]);
  assert.ok(Math.abs(control.target.x + 2 / 7) < 1e-9 && control.target.y === 0);
  assert.ok(Math.abs(control.axisTarget(0) - 0.5) < 0.1);
  assert.equal(line.hands.at(-1).buttons, 2);
});

test("a press while the page has no focus counts only after its release; unplugging releases", () => {
  const { control } = steered();
  const one = pad();
  hardware.pads = [one];
  steerByController(control, () => 0);
  happen("gamepadconnected");
  paper.focused = false;
  one.buttons[4].value = 1;
  pass(50);
  paper.focused = true;
  pass(50);
  assert.equal(control.source, null);
  one.buttons[4].value = 0;
  pass(50);
  one.buttons[4].value = 1;
  pass(50);
  assert.equal(control.source, "controller");
  hardware.pads = [null];
  happen("gamepaddisconnected");
  assert.equal(control.source, null);
});

/** A pointer on a surface that is pressed at (20, 10), and what happens in the window. */
function pointed(head) {
  const { line, control } = steered();
  line.state.joystick = { axes: [{ position: 0.1, half_range: 0.2 }, { position: 0, half_range: 1 }] };
  const surface = new Element();
  surface.setPointerCapture = () => undefined;
  surface.hasPointerCapture = () => surface.captured;
  steerByPointer(surface, control, () => ({ x: 100, y: 50 }), head);
  const fields = { pointerId: 1, buttons: 1, clientX: 20, clientY: 10, isPrimary: true, button: 0 };
  const press = (more) => surface.dispatchEvent(event("pointerdown", { ...fields, ...more }, PointerEvent));
  const send = (name, more) => happen(name, { ...fields, ...more }, PointerEvent);
  return { control, surface, press, send };
}

test("a pointer drags from where the handle is, up is up, and only the primary button presses", () => {
  const { control, press, send } = pointed();
  press({ button: 2 });
  press({ isPrimary: false });
  assert.equal(control.source, null);
  press();
  send("pointermove", { clientX: 70, clientY: 0 });
  assert.deepEqual(control.target, { x: 0.5, y: 0.2 });
  send("pointermove", { pointerId: 2, clientX: 90 });
  send("pointerup", { pointerId: 2 });
  assert.deepEqual(control.target, { x: 0.5, y: 0.2 });
  send("pointerup");
  assert.equal(control.source, null);
  send("pointermove", { clientX: 90 });
  assert.equal(control.target, null);
});

test("on the picture of a robot with a head a drag turns it, and x and y stay", () => {
  const { control, press, send } = pointed(() => ({ pan: 1, tilt: 0 }));
  press();
  send("pointermove", { clientX: 70, clientY: 0 });
  assert.deepEqual([control.target, control.axisTarget(1), control.axisTarget(0)], [{ x: 0, y: 0 }, 0.5, 0.7]);
});

test("a pointer whose release nobody saw, or that left the window, lets go", () => {
  const ends = [
    ["pointermove", { buttons: 0 }],
    ["pointercancel", {}],
    ["pointerout", { relatedTarget: null }],
  ];
  for (const [name, fields] of ends) {
    const { control, press, send } = pointed();
    press();
    send(name, fields);
    assert.equal(control.source, null, name);
  }
  const { control, surface, press, send } = pointed();
  press();
  send("pointerout", { relatedTarget: {} });
  surface.captured = true;
  send("pointerout", { relatedTarget: null });
  assert.equal(control.source, "pointer");
});

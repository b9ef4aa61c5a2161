/** A headset's controller that steers: what its poses move, and all that lets go. */
import assert from "node:assert/strict";
import { test } from "node:test";
import { Line, haptics } from "./page.mjs";
import { load } from "./modules.mjs";

const { HandControl } = await load("hand_control.js");
const { HeadsetHand, placeBefore } = await load("headset_hand.js");

const NAMES = ["z", "yaw", "gripper", "pan", "tilt"];
const FRAME_MS = 14;
const about = (angle, axis) => ({ x: 0, y: 0, z: 0, [axis]: Math.sin(angle / 2), w: Math.cos(angle / 2) });

/** A hand in a headset: `see` shows it a frame. */
function worn() {
  const line = new Line();
  const axes = NAMES.map((name) => ({ name, position: 0, half_range: name === "z" ? 0.1 : 1 }));
  Object.assign(line.state, { hand: { holder: 1, you: true, who: "operator" }, joystick: { axes } });
  const control = new HandControl(line);
  line.tell("haptic", haptics("joystick", 0.05, 0));
  const hand = new HeadsetHand(control, () => ({ x: 0.1, y: 0.05 }), () => axes);
  let nowMs = 0;
  const one = { name: "right", squeeze: 0, trigger: 0.5, stick: { x: 0, y: 0 }, pose: { position: { x: 0.3, y: -0.2, z: 0.4 }, turn: about(1, "y") } };
  const see = (changes = {}, ms = FRAME_MS) => {
    nowMs += ms;
    Object.assign(one, changes);
    hand.handleFrame([{ ...one }], nowMs);
  };
  const at = (x, y, z, turn = about(1, "y")) => ({ pose: { position: { x: 0.3 + x, y: -0.2 + y, z: 0.4 + z }, turn } });
  const grip = () => {
    see({ squeeze: 0 });
    see({ squeeze: 1 });
  };
  const more = (name) => control.axisTarget(NAMES.indexOf(name));
  return { line, control, hand, see, at, grip, more, one, now: () => nowMs };
}

test("while the grip is held the controller leads the handle from where it is, in its own metres", () => {
  const { line, control, hand, see, at, grip, more } = worn();
  see(at(0.02, 0.01, 0));
  see();
  assert.equal(control.source, null);
  grip();
  assert.equal(hand.holder, "right");
  see(at(0.04, 0.02, -0.03));
  const { x, y } = control.target;
  assert.deepEqual([x, y, more("z")].map((one) => one.toFixed(6)), ["0.700000", "0.200000", "-0.300000"]);
  see({ squeeze: 0 });
  assert.deepEqual([control.source, line.hands.at(-1).deadMan], [null, false]);
});

test("it turns an axis by its own turn, past half a turn without a jump", () => {
  const { see, at, grip, more } = worn();
  see(at(0, 0, 0, about(0.3, "z")));
  grip();
  see(at(0, 0, 0, about(0.8, "z")));
  assert.ok(Math.abs(more("yaw") - 0.5) < 1e-9);
  for (let angle = 0.8; angle < 5; angle += 0.2) see(at(0, 0, 0, about(angle, "z")));
  assert.equal(more("yaw"), 1);
  const flipped = Object.fromEntries(Object.entries(about(5, "z")).map(([name, value]) => [name, -value]));
  see(at(0, 0, 0, flipped));
  assert.equal(more("yaw"), 1);
});

test("a trigger takes the gripper along once it has met it; a stick turns the head at a speed", () => {
  const { see, grip, more } = worn();
  see({ trigger: 0 });
  grip();
  see({ trigger: 0.3 });
  assert.equal(more("gripper"), 0);
  see({ trigger: 0.6 });
  assert.ok(Math.abs(more("gripper") - 0.2) < 1e-9);
  see({ trigger: 0 });
  assert.equal(more("gripper"), -1);
  see({ stick: { x: 0.1, y: 1 } });
  see();
  assert.equal(more("pan"), 0);
  assert.ok(more("tilt") > 0.01 && more("tilt") < 0.02);
});

test("whatever takes the person or the tracking away lets go, and motion needs a new press", () => {
  const away = {
    tracking: ({ see }) => see({ pose: null }),
    jump: ({ see, at }) => see(at(0.5, 0, 0)),
    controller: ({ hand, now }) => hand.handleFrame([], now() + 1),
    pause: ({ see }) => see({}, 150),
    silence: ({ hand, now }) => hand.pollTimeout(now() + 101),
    blur: ({ hand }) => hand.letGo(),
    page: ({ control }) => control.releaseAll(),
    server: ({ line }) => line.tell("lost", {}),
  };
  for (const [why, act] of Object.entries(away)) {
    const one = worn();
    one.see();
    one.grip();
    assert.equal(one.control.source, "headset", why);
    act(one);
    assert.deepEqual([one.control.source, one.hand.holder], [null, null], why);
    one.see(one.at(0, 0, 0));
    one.see();
    one.see();
    assert.equal(one.control.source, null, why);
    one.grip();
    assert.equal(one.control.source, "headset", why);
    one.control.releaseAll();
  }
});

test("a grip that is closed when the session begins is no press, nor is a second controller's", () => {
  const { hand, control, one, see, now } = worn();
  see({ squeeze: 1 });
  see();
  assert.equal(control.source, null);
  see({ squeeze: 0 });
  const both = (right, left, ms) =>
    hand.handleFrame([{ ...one, squeeze: right }, { ...one, name: "left", squeeze: left }], now() + ms);
  both(0, 0, 10);
  both(1, 0, 20);
  both(1, 1, 30);
  assert.equal(hand.holder, "right");
  both(0, 1, 40);
  assert.deepEqual([hand.holder, control.source], [null, null]);
});

test("the picture stands upright before the person, whichever way the head looks", () => {
  // To the left, and down.
  const [a, b] = [about(Math.PI / 2, "y"), about(-0.5, "x")];
  const turn = { x: a.w * b.x, y: a.y * b.w, z: -a.y * b.x, w: a.w * b.w };
  const place = placeBefore({ position: { x: 1, y: 1.6, z: 0 }, turn }, 2);
  const near = (found, wanted) => assert.ok(Math.abs(found - wanted) < 1e-6, `${found}: not ${wanted}`);
  near(place.position.x, -1);
  near(place.position.y, 1.6);
  near(place.position.z, 0);
  near(place.turn.y, Math.SQRT1_2);
  near(place.turn.w, Math.SQRT1_2);
});

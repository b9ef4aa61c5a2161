/** The hand is sent while it is held; it is released once, and whatever happens. */
import assert from "node:assert/strict";
import { test } from "node:test";
import { load } from "./modules.mjs";

const { HandSender } = await load("hand_sender.js");
const HELD = { deadMan: true, x: 0.5, y: -0.25, buttons: 1 };
const RELEASED = { deadMan: false, x: 0, y: 0, buttons: 0 };

/** What is sent from `fromMs` to `toMs`, looked for each 4 ms. */
function sent(sender, fromMs, toMs) {
  const hands = [];
  for (let ms = fromMs; ms < toMs; ms += 4) hands.push(sender.pollTransmit(ms));
  return hands.filter((hand) => hand !== null);
}

test("a held hand is sent each time, its release once", () => {
  const sender = new HandSender();
  sender.handleHand(HELD, 0);
  assert.equal(sent(sender, 0, 80).filter((hand) => hand.deadMan).length, 20);
  sender.handleHand(RELEASED, 80);
  assert.deepEqual(sent(sender, 80, 200), [RELEASED]);
  assert.equal(sender.active, false);
});

test("a page that is silent for 100 ms lets go, and must press anew", () => {
  const sender = new HandSender();
  sender.handleHand(HELD, 0);
  const hands = sent(sender, 0, 200);
  assert.equal(hands.filter((hand) => hand.deadMan).length, 26);
  assert.deepEqual(hands.at(-1), RELEASED);
  sender.handleHand(HELD, 200);
  assert.deepEqual(sent(sender, 200, 240), []);
  sender.handleHand(RELEASED, 240);
  sender.handleHand(HELD, 244);
  assert.deepEqual(sent(sender, 248, 252), [HELD]);
});

test("news after a silence in which nothing was sent do not hide it", () => {
  const sender = new HandSender();
  sender.handleHand(HELD, 0);
  sender.handleHand(HELD, 150);
  assert.deepEqual(sent(sender, 152, 200), [RELEASED]);
  assert.equal(sender.pressAnew, true);
});

test("after the loss of the server the hand must press anew", () => {
  const sender = new HandSender();
  sender.handleHand(HELD, 0);
  sender.handleLost();
  assert.deepEqual(sent(sender, 0, 8), [RELEASED]);
  sender.handleHand(HELD, 10);
  assert.deepEqual(sent(sender, 12, 40), []);
  sender.handleHand(RELEASED, 40);
  sender.handleHand(HELD, 41);
  assert.deepEqual(sent(sender, 44, 48), [HELD]);
});

test("a fast mouse cannot make the server close the page", () => {
  const sender = new HandSender();
  let count = 0;
  for (let us = 0; us < 1_000_000; us += 125) {
    sender.handleHand(HELD, us / 1000);
    if (sender.pollTransmit(us / 1000) !== null) count += 1;
  }
  assert.ok(count <= 700, `${count} in a second`);
});

test("a release goes out at once, however short its distance to the message before", () => {
  const sender = new HandSender();
  sender.handleHand(HELD, 0);
  assert.deepEqual(sender.pollTransmit(0), HELD);
  sender.handleHand(RELEASED, 0.1);
  assert.deepEqual(sender.pollTransmit(0.1), RELEASED);
});

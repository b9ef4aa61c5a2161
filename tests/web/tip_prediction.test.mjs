/** The predicted tip is where the robot will be, also after a press that begins elsewhere. */
import assert from "node:assert/strict";
import { test } from "node:test";
import { load } from "./modules.mjs";

const { TipPrediction, fitted, shareOf } = await load("tip_prediction.js");

const ROUND_TRIP_MS = 800;
const place = (xM, yM) => ({ xM, yM });

test("a press begins where the robot is, and the tip follows the hand from there", () => {
  const prediction = new TipPrediction();
  prediction.handleHand(place(0.02, 0), false, 0);
  assert.equal(prediction.tip, null);
  prediction.handleTold("place", place(-0.01, 0.03), 2_000_000, ROUND_TRIP_MS);
  prediction.handleHand(place(0.02, 0), true, 3_000_000);
  prediction.handleHand(place(0.03, 0.01), true, 3_100_000);
  assert.deepEqual(prediction.tip, place(0, 0.04));
  prediction.handleHand(place(0.03, 0.01), false, 3_200_000);
  assert.equal(prediction.tip, null);
  prediction.handleHand(place(0, 0), true, 4_000_000);
  assert.deepEqual(prediction.tip, place(0, 0.04));
});

test("what the robot told before it knew of the press is of no use", () => {
  const prediction = new TipPrediction();
  prediction.handleHand(place(0.02, 0), false, 0);
  prediction.handleHand(place(0.02, 0), true, 1_000_000);
  prediction.handleTold("offset", place(0.5, 0.5), 1_700_000, ROUND_TRIP_MS);
  prediction.handleHand(place(0.02, 0), true, 1_750_000);
  assert.equal(prediction.tip, null);
  // The hand rests, so nothing else is heard of it.
  prediction.handleTold("offset", place(-0.02, 0), 1_900_000, ROUND_TRIP_MS);
  assert.deepEqual(prediction.tip, place(0, 0));
  prediction.handleTold("place", place(0.009, 0), 2_800_000, ROUND_TRIP_MS);
  assert.deepEqual(prediction.tip, place(0, 0));
  prediction.handleTold("place", place(0.007, 0), 2_900_000, ROUND_TRIP_MS);
  assert.deepEqual(prediction.tip, place(0.007, 0));
  prediction.handleHand(place(0.04, 0), true, 2_950_000);
  assert.deepEqual(prediction.tip, place(0.02, 0));
  prediction.forget();
  assert.equal(prediction.tip, null);
});

test("a place on the board is at its share of a fitted picture, and behind the camera nowhere", () => {
  const view = [2, 0, 0.5, 0, -2.5, 0.5, 0, 0, 1];
  assert.deepEqual(shareOf(view, 0.1, -0.1), { x: 0.7, y: 0.75 });
  assert.equal(shareOf([1, 0, 0, 0, 1, 0, 0, 1, 0], 0, -1), null);
  assert.deepEqual(fitted(800, 300, 4 / 3), { left: 200, top: 0, wide: 400, high: 300 });
  assert.deepEqual(fitted(400, 500, 4 / 3), { left: 0, top: 100, wide: 400, high: 300 });
});

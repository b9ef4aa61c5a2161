/** The clocks, the stock of a voice, and pictures as I420. */
import assert from "node:assert/strict";
import { test } from "node:test";
import { load } from "./modules.mjs";

const { BlockClock } = await load("block_clock.js");
const { ClockOffset } = await load("clock_offset.js");
const { SoundRing } = await load("sound_ring.js");
const { codecOf } = await load("avc.js");
const { fromNv12, fromRgba } = await load("i420.js");

test("the answer that waited least gives the clock's offset", () => {
  const clock = new ClockOffset();
  assert.equal(clock.best, null);
  clock.handleAnswer(100, 5_000_000, 140);
  clock.handleAnswer(200, 5_101_000, 202);
  clock.handleAnswer(300, 5_230_000, 360);
  assert.deepEqual(clock.best, { roundTripMs: 2, offsetUs: 4_900_000 });
  for (let ms = 400; ms < 2000; ms += 100) clock.handleAnswer(ms, 5_000_000 + 1000 * ms, ms + 10);
  assert.equal(clock.best.roundTripMs, 10);
});

test("a block is dated by the one that came with the least delay", () => {
  const clock = new BlockClock();
  assert.equal(clock.handleBlock(0, 20, 1025), 1005);
  assert.equal(clock.handleBlock(20, 20, 1041), 1021);
  assert.equal(clock.handleBlock(40, 20, 1090), 1041);
  // The device stood still for a second.
  assert.equal(clock.handleBlock(60, 20, 2080), 2060);
});

const block = (value) => new Int16Array(960).fill(value);

test("a voice begins at 40 ms of stock, and again after it ran dry", () => {
  const ring = new SoundRing();
  const output = new Float32Array(480);
  ring.handleSound(block(16384), 0);
  ring.read(output);
  assert.equal(output[0], 0);
  ring.handleSound(block(16384), 20_000);
  ring.read(output);
  assert.equal(output[479], 0.5);
  assert.equal(ring.captureUs, 10_000);
  for (let reads = 0; reads < 4; reads += 1) ring.read(output);
  assert.equal(output[0], 0);
  assert.equal(ring.dry, 1);
});

test("of too much sound the oldest goes", () => {
  const ring = new SoundRing();
  for (let number = 0; number < 7; number += 1) ring.handleSound(block(number), 20_000 * number);
  assert.equal(ring.stockMs, 40);
  assert.equal(ring.captureUs, 100_000);
  assert.equal(ring.dropped, 5 * 960);
});

test("what was not needed for a second goes, and the spare shrinks while nothing runs dry", () => {
  const ring = new SoundRing();
  const output = new Float32Array(960);
  for (let number = 0; number < 5; number += 1) ring.handleSound(block(1), null);
  /** @param {number} seconds */
  const play = (seconds) => {
    for (let reads = 0; reads < 50 * seconds; reads += 1) {
      ring.read(output);
      ring.handleSound(block(1), null);
    }
    ring.read(output);
    const { stockMs } = ring;
    ring.handleSound(block(1), null);
    return stockMs;
  };
  assert.equal(play(2), 20);
  assert.equal(play(18), 10);
  for (let reads = 0; reads < 3; reads += 1) ring.read(output);
  assert.equal(ring.dry, 1);
});

test("a voice that ran dry begins again with a larger spare", () => {
  const ring = new SoundRing();
  const output = new Float32Array(960);
  for (const blocks of [2, 3, 4, 4]) {
    for (let number = 1; number < blocks; number += 1) {
      ring.handleSound(block(16384), null);
      ring.read(output);
      assert.equal(output[0], 0, `${blocks} blocks are waited for`);
    }
    ring.handleSound(block(16384), null);
    for (let reads = 0; reads < blocks; reads += 1) ring.read(output);
    assert.equal(output[0], 0.5);
    ring.read(output);
  }
  assert.equal(ring.dry, 4);
});

test("the codec is that of the first SPS", () => {
  const unit = (hex) => Uint8Array.from(Buffer.from(hex.replaceAll(" ", ""), "hex"));
  assert.equal(codecOf(unit("00000001 0910 00000001 67 42c01e 8c00 00000001 68ce 000001 6588")), "avc1.42c01e");
  assert.equal(codecOf(unit("000001 6588840000")), null);
});

test("white and red in I420, from RGBA and from NV12", () => {
  const i420 = new Uint8Array(6);
  fromRgba(new Uint8ClampedArray(16).fill(255), 2, 2, i420);
  assert.deepEqual([...i420], [235, 235, 235, 235, 128, 128]);
  fromRgba(new Uint8ClampedArray([255, 0, 0, 255, 255, 0, 0, 255, 255, 0, 0, 255, 255, 0, 0, 255]), 2, 2, i420);
  assert.deepEqual([...i420], [82, 82, 82, 82, 90, 240]);
  const planar = new Uint8Array(12);
  fromNv12(Uint8Array.from([1, 2, 3, 4, 5, 6, 7, 8, 21, 31, 22, 32]), planar);
  assert.deepEqual([...planar], [1, 2, 3, 4, 5, 6, 7, 8, 21, 22, 31, 32]);
});

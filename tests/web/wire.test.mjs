/** Messages octet by octet, as pipelines/seats packs and parses them. */
import assert from "node:assert/strict";
import { test } from "node:test";
import { load } from "./modules.mjs";

const wire = await load("wire.js");
const octets = (hex) => Uint8Array.from(Buffer.from(hex.replaceAll(" ", ""), "hex")).buffer;
const hex = (buffer) => Buffer.from(buffer).toString("hex");

test("a unit", () => {
  const unit = wire.readUnit(octets("01 02 05 00 2a000000 40420f0000000000 00000001 65"));
  assert.deepEqual({ ...unit, data: hex(unit.data) }, {
    stream: 2, key: true, damaged: false, replayed: true, sequence: 42, captureUs: 1_000_000, data: "0000000165",
  });
  assert.equal(wire.readUnit(octets("01 00 00 00 00000000 ffffffffffffffff")).captureUs, null);
});

test("a block of sound", () => {
  const sound = wire.readSound(octets("02 01 01 00 07000000 0a00000000000000 0100 ffff"));
  assert.equal(sound.concealed, true);
  assert.equal(sound.captureUs, 10);
  assert.deepEqual([...sound.samples], [1, -1]);
});

test("rows of haptics, with the place of one more axis", () => {
  const row = "000000000000f03f 0000003f 000000bf 00000040 000040c0 00008040 0000c03f 01030200";
  const haptics = wire.readHaptics(octets(`03 01 0200 00000000 ${row} ${row}`));
  assert.deepEqual([...haptics.columns[5]], [1.5, 1.5]);
  assert.equal(haptics.end, "robot");
  assert.equal(haptics.timeUs[0], 1);
  const columns = [haptics.xM, haptics.yM, haptics.forceXN, haptics.forceYN, haptics.energyUj];
  assert.deepEqual(columns.map(([first]) => first), [0.5, -0.5, 2, -3, 4]);
  assert.equal(haptics.flags[0] & wire.HapticFlag.CONTACT, 1);
  assert.equal(wire.stateNumber(haptics.flags[0]), 3);
  assert.equal(wire.litLed(haptics.flags[0]), 1);
  assert.equal(wire.litLed(0), null);
});

test("a pong answers a ping", () => {
  assert.equal(hex(wire.writePing(1.5)), "8100000000000000000000000000f83f");
  const pong = wire.readPong(octets("05 00000000000000 000000000000f83f 0500000000000000"));
  assert.deepEqual(pong, { pageMs: 1.5, nowUs: 5 });
});

test("the hand", () => {
  const hand = { deadMan: true, x: 0.5, y: -1, buttons: 3 };
  assert.equal(hex(wire.writeHand(hand, 9, 1.5)), "82010300090000000000003f000080bf000000000000f83f");
});

test("the page's own picture and sound", () => {
  const { message, i420 } = wire.ownPicture(1, 4, 2, 1.5);
  i420.fill(7);
  assert.equal(hex(message), `8301040002000000000000000000f83f${"07".repeat(12)}`);
  const sound = wire.writeOwnSound(2, 5, 1.5, new Int16Array(960).fill(-2));
  assert.equal(hex(sound.slice(0, 18)), "8402c00305000000000000000000f83ffeff");
  assert.equal(sound.byteLength, 16 + 1920);
});

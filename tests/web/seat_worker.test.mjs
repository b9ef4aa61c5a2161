/** The seat's worker: one connection after the other, and the hand let go with each. */
import assert from "node:assert/strict";
import { test } from "node:test";
import { answers, clockMs, made, pass, settle, told } from "./page.mjs";
import { begin } from "./modules.mjs";

const decoders = [];
globalThis.VideoDecoder = class {
  state = "configured";
  constructor(acts) {
    Object.assign(this, acts);
    decoders.push(this);
  }
  configure() {}
  decode({ timestamp }) {
    this.timestamp = timestamp;
  }
  close() {
    this.state = "closed";
  }
};
const octets = (hex) => Uint8Array.from(Buffer.from(hex.replaceAll(" ", ""), "hex")).buffer;
const HELLO = { kind: "hello", streams: [{ index: 2, name: "uplink_video", kind: "video" }, { index: 4, name: "uplink_voice", kind: "voice" }] };
const KEY = "01 02 01 00 2a000000 40420f0000000000 00000001 6742c01e 000001 65";
const HELD = { deadMan: true, x: 0.5, y: 0, buttons: 0 };

/** A worker with an open connection. */
async function opened() {
  await begin("seat_worker.js");
  made.socket.open();
  made.socket.hear(HELLO);
  told.length = 0;
  return made.socket;
}
const kinds = () => told.splice(0).map(({ kind }) => kind);
const note = (data) => self.onmessage({ data });
/** Hands that were sent: whether the button is pressed. */
const hands = (socket) => socket.sent.filter((one) => one instanceof ArrayBuffer && new DataView(one).getUint8(0) === 0x82).map((one) => new DataView(one).getUint8(1) === 1);
/** What was sent of this type. */
const count = (socket, type) => socket.sent.filter((one) => one instanceof ArrayBuffer && new DataView(one).getUint8(0) === type).length;

test("a server that is silent is lost, though connected, and heard again with its next word", async () => {
  const socket = await opened();
  for (let turn = 0; turn < 10; turn += 1) {
    pass(100);
    socket.hear({ kind: "state" });
  }
  assert.ok(!kinds().includes("lost"));
  pass(500);
  assert.deepEqual(told.splice(0).filter(({ kind }) => kind === "lost").map(({ why }) => why), ["silent"]);
  pass(2000);
  assert.deepEqual(kinds(), []);
  socket.hear({ kind: "state" });
  assert.deepEqual(kinds(), ["heard", "text"]);
  assert.equal(made.socket, socket);
});

test("a closed connection is followed by another, which begins with the clock", async () => {
  const socket = await opened();
  socket.close(1006, "gone");
  assert.deepEqual(told.splice(0).map(({ kind, why, reason }) => [kind, why, reason]), [["lost", "closed", "gone"]]);
  pass(300);
  assert.notEqual(made.socket, socket);
  made.socket.open();
  assert.equal(count(made.socket, 0x81), 1);
  pass(40);
  const pong = Buffer.from(`05${"00".repeat(23)}`, "hex");
  pong.writeDoubleLE(clockMs() - 40, 8);
  pong.writeBigInt64LE(9_000_000n, 16);
  made.socket.hear(new Uint8Array(pong).buffer);
  const { roundTripMs, offsetUs } = told.find(({ kind }) => kind === "clock");
  assert.equal(roundTripMs, 40);
  assert.equal(offsetUs, 9_000_000 - 1000 * (clockMs() - 20));
});

test("pings are frequent at first, then one a second", async () => {
  const socket = await opened();
  pass(2000);
  const first = count(socket, 0x81);
  pass(10_000);
  assert.ok(first >= 6 && first <= 9, String(first));
  const later = count(socket, 0x81) - first;
  assert.ok(later >= 8 && later <= 11, String(later));
});

test("a token of another session is refused for good; a server that is away is tried again", async () => {
  await begin("seat_worker.js");
  made.socket.close(1006);
  await settle();
  const { length } = made.sockets;
  pass(300);
  assert.equal(made.sockets.length, length + 1);
  told.length = 0;
  answers.GET = () => ({ of: { status: 403, ok: false } });
  made.socket.close(1006);
  await settle();
  assert.equal(told.at(-1).why, "refused");
  const after = made.sockets.length;
  pass(10_000);
  assert.equal(made.sockets.length, after);
  delete answers.GET;
});

test("while the page draws, only the newest picture waits, and those between are closed", async () => {
  const socket = await opened();
  socket.hear(octets(KEY));
  const decoder = decoders.at(-1);
  const frames = [];
  for (let picture = 0; picture < 4; picture += 1) {
    if (picture > 0) socket.hear(octets("01 02 00 00 2b000000 40420f0000000000 000001 41"));
    const frame = { timestamp: decoder.timestamp, close: () => (frame.closed = true) };
    decoder.output(frame);
    frames.push(frame);
  }
  assert.deepEqual(kinds().filter((kind) => kind === "frame").length, 1);
  assert.deepEqual(frames.map(({ closed }) => closed === true), [false, true, true, false]);
  note({ kind: "drawn", stream: 2 });
  assert.equal(told.at(-1).frame, frames[3]);
  note({ kind: "drawn", stream: 2 });
  note({ kind: "drawn", stream: 9 });
  assert.deepEqual(kinds(), ["frame"]);
});

test("a decoder's fault waits for a replay, and connects anew if none comes", async () => {
  const socket = await opened();
  socket.hear(octets(KEY));
  decoders.at(-1).error(new Error("broken"));
  assert.deepEqual(told.at(-1), { kind: "fault", stream: 2, why: "broken" });
  pass(1000);
  socket.hear(octets(KEY));
  pass(3000);
  assert.equal(socket.readyState, 1);
  decoders.at(-1).error(new Error("broken"));
  pass(2000);
  assert.equal(socket.readyState, 3);
});

test("a hand that is held is sent on; with the loss of the server it is released and told so", async () => {
  const socket = await opened();
  for (let turn = 0; turn < 10; turn += 1) {
    note({ kind: "hand", hand: HELD });
    socket.hear({ kind: "state" });
    pass(30);
  }
  assert.ok(hands(socket).length > 50 && hands(socket).every(Boolean));
  told.length = 0;
  for (let turn = 0; turn < 12; turn += 1) {
    note({ kind: "hand", hand: HELD });
    pass(30);
  }
  assert.equal(kinds().filter((kind) => kind === "let_go").length, 1);
  assert.equal(hands(socket).filter((held) => !held).length, 1);
  assert.equal(hands(socket).at(-1), false);
});

test("a full socket gets no more places of the hand, but its release", async () => {
  const socket = await opened();
  socket.bufferedAmount = 10_000;
  note({ kind: "hand", hand: HELD });
  pass(50);
  assert.deepEqual(hands(socket), []);
  note({ kind: "hand", hand: { ...HELD, deadMan: false } });
  assert.deepEqual(hands(socket), [false]);
});

test("sound goes to the port of its stream, small pictures and rows of haptics to the page", async () => {
  const socket = await opened();
  const heard = [];
  note({ kind: "sound_port", stream: "uplink_voice", port: { postMessage: (one) => heard.push(one) } });
  for (const stream of ["04", "05"]) socket.hear(octets(`02 ${stream} 01 00 07000000 0a00000000000000 0100 ffff`));
  assert.deepEqual(heard.map(({ captureUs, concealed }) => [captureUs, concealed]), [[10, true]]);
  socket.hear(octets(`04 03 0200 0200 0000 ffffffffffffffff ${"80".repeat(6)}`));
  const { preview, frame, captureUs } = told.at(-1);
  assert.deepEqual([preview, frame.codedWidth, frame.data.length, captureUs], [3, 2, 6, null]);
  socket.hear(octets("03 01 0000 00000000"));
  assert.equal(told.at(-1).kind, "haptic");
  note({ kind: "request", text: "{}" });
  assert.equal(socket.sent.at(-1), "{}");
});

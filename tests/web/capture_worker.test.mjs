/** The page's own camera and microphone on their way to the server. */
import assert from "node:assert/strict";
import { test } from "node:test";
import { clockMs, made, pass, settle, told } from "./page.mjs";
import { begin } from "./modules.mjs";

const INPUT = { index: 1, name: "iss_mic", kind: "audio" };
const BLOCK = { samples: new Int16Array(960).fill(3), firstMs: 20 };

/** A worker that is to send sound; `block()` is one from the microphone. */
async function started() {
  await begin("capture_worker.js");
  const port = {};
  self.onmessage({ data: { kind: "sound", input: INPUT, port } });
  told.length = 0;
  return { socket: made.socket, block: () => port.onmessage({ data: BLOCK }) };
}
const answer = (socket, fields) => socket.hear({ kind: "answer", request: 1, ...fields });
const sounds = (socket) => socket.sent.filter((one) => one instanceof ArrayBuffer && new DataView(one).getUint8(0) === 0x84).map((one) => new DataView(one).getUint32(4, true));
const kinds = () => told.splice(0).map(({ kind }) => kind);

test("sound is sent only while the server has given the input to this page", async () => {
  const { socket, block } = await started();
  block();
  socket.open();
  assert.deepEqual(JSON.parse(socket.sent.find((one) => typeof one === "string")), { request: 1, do: "input", name: "iss_mic", on: true });
  block();
  assert.deepEqual(sounds(socket), []);
  answer(socket, { ok: true });
  block();
  assert.deepEqual([kinds(), sounds(socket)], [["taken"], [3]]);
  // Too much waits: what comes now would only be late.
  socket.bufferedAmount = 20_000;
  block();
  socket.bufferedAmount = 0;
  block();
  assert.deepEqual(sounds(socket), [3, 5]);
});

test("a refusal ends it; a lost connection is tried again and asks anew", async () => {
  const first = await started();
  first.socket.open();
  answer(first.socket, { ok: false, error: "another page has it" });
  assert.deepEqual(told.splice(0), [{ kind: "refused", why: "another page has it" }]);
  pass(5000);
  assert.equal(made.socket, first.socket);

  const { socket, block } = await started();
  socket.open();
  answer(socket, { ok: true });
  socket.close(1006);
  assert.deepEqual(kinds(), ["taken", "lost"]);
  pass(300);
  assert.notEqual(made.socket, socket);
  made.socket.open();
  block();
  assert.deepEqual(sounds(made.socket), []);
  answer(made.socket, { ok: true });
  block();
  assert.equal(sounds(made.socket).length, 1);
  made.socket.close(1008, "too much");
  assert.deepEqual(told.at(-1), { kind: "refused", why: "too much" });
});

test("pictures keep the input's rate, none waits behind another, and each frame is closed", async () => {
  globalThis.OffscreenCanvas = class {
    getContext = () => ({ drawImage() {}, getImageData: (_x, _y, width, height) => ({ data: new Uint8ClampedArray(4 * width * height) }) });
  };
  await begin("capture_worker.js");
  const frames = [];
  let give;
  const reader = { read: () => new Promise((resolve) => (give = resolve)) };
  self.onmessage({ data: { kind: "pictures", input: { index: 0, name: "iss_camera", kind: "video", width: 4, height: 2, fps: 10 }, frames: { getReader: () => reader } } });
  const { socket } = made;
  const pictures = () => socket.sent.filter((one) => one instanceof ArrayBuffer && new DataView(one).getUint8(0) === 0x83).length;
  async function film(count, ms) {
    for (let number = 0; number < count; number += 1) {
      pass(ms);
      const frame = { format: null, displayWidth: 4, displayHeight: 2, codedWidth: 4, codedHeight: 2, close: () => (frame.closed = true) };
      frames.push(frame);
      give({ value: frame, done: false });
      await settle();
    }
  }
  await film(3, 100);
  assert.equal(pictures(), 0);
  socket.open();
  answer(socket, { ok: true });
  await film(10, 100);
  assert.equal(pictures(), 10);
  // A camera that is four times as fast.
  await film(12, 25);
  assert.ok(pictures() - 10 <= 4, String(pictures()));
  const before = pictures();
  socket.bufferedAmount = 1;
  await film(3, 100);
  assert.equal(pictures(), before);
  assert.ok(frames.every(({ closed }) => closed) && clockMs() > 0);
});

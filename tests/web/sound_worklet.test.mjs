/** The worklets: a voice that is played, and a microphone that is cut into blocks. */
import assert from "node:assert/strict";
import { test } from "node:test";
import "./page.mjs";
import { begin } from "./modules.mjs";

const processors = {};
globalThis.registerProcessor = (name, kind) => (processors[name] = kind);
globalThis.sampleRate = 48_000;
globalThis.currentFrame = 0;
globalThis.AudioWorkletProcessor = class {
  notes = [];
  port = { postMessage: (note) => this.notes.push(note) };
};
await begin("sound_worklet.js");
await begin("capture_worklet.js");

const SAMPLES = 128;
const play = (player, count) => {
  const output = new Float32Array(SAMPLES);
  for (let turn = 0; turn < count; turn += 1) player.process([], [[output]]);
  return output;
};

test("a voice is played from its port, and its level and stock are told ten times a second", () => {
  const player = new processors["sound-player"]();
  const port = {};
  player.port.onmessage({ data: { port } });
  assert.ok(play(player, 10).every((one) => one === 0));
  for (let block = 0; block < 5; block += 1) port.onmessage({ data: { samples: new Int16Array(960).fill(-16_384), captureUs: 20_000 * block } });
  assert.ok(play(player, 20).every((one) => one === -0.5));
  play(player, 345);
  assert.equal(player.notes.length, Math.floor((375 * SAMPLES) / 4864));
  const [first] = player.notes;
  assert.equal(first.peak, 0.5);
  assert.ok(first.captureUs > 0 && first.stockMs >= 0);
  // It ran dry, and the level is that since the note before.
  assert.deepEqual([player.notes.at(-1).peak, player.notes.at(-1).dry > 0], [0, true]);
  assert.equal(player.process([], []), true);
});

/** Gives a microphone so many turns of one level; returns the blocks that it has sent by then. */
function speak(microphone, level, turns) {
  for (let turn = 0; turn < turns; turn += 1) {
    microphone.process([[new Float32Array(SAMPLES).fill(level)]]);
    currentFrame += SAMPLES;
  }
}

test("a microphone sends blocks of 20 ms without a gap; muted they are silent, and its level is told", () => {
  const microphone = new processors["microphone-blocks"]();
  const blocks = [];
  microphone.port.onmessage({ data: { port: { postMessage: (note) => blocks.push(note) } } });
  speak(microphone, 0.5, 75);
  assert.deepEqual([...new Set(blocks.map(({ firstMs }, at) => firstMs - 20 * at))], [0]);
  assert.equal(blocks.length, 10);
  assert.ok(blocks.every(({ samples }) => samples.every((one) => one === 0)));
  assert.equal(microphone.notes[0].peak, 0.5);
  microphone.port.onmessage({ data: { muted: false } });
  speak(microphone, -2, 15);
  assert.ok(blocks.at(-1).samples.every((one) => one === -32_767));
  assert.equal(blocks.length, 12);
  assert.equal(microphone.process([]), true);
  microphone.port.onmessage({ data: { closed: true } });
  assert.equal(microphone.process([[new Float32Array(SAMPLES)]]), false);
});

/** Which units a decoder is given, and which pictures come out of it. */
import assert from "node:assert/strict";
import { test } from "node:test";
import "./page.mjs";
import { load } from "./modules.mjs";

/** A decoder of the browser: keeps what it is given. */
const decoders = [];
globalThis.VideoDecoder = class {
  state = "configured";
  chunks = [];
  constructor(acts) {
    Object.assign(this, acts);
    decoders.push(this);
  }
  configure(how) {
    this.how = how;
  }
  decode(chunk) {
    if (this.broken) throw new TypeError("broken");
    this.chunks.push(chunk);
  }
  close() {
    this.state = "closed";
  }
  /** It shows the picture of its newest chunk, or of that one. */
  show(chunk = this.chunks.at(-1)) {
    const frame = { timestamp: chunk.timestamp, close: () => (frame.closed = true) };
    this.output(frame);
    return frame;
  }
};

const { StreamDecoder } = await load("stream_decoder.js");
const sps = (profile) => Uint8Array.from([0, 0, 0, 1, 0x67, 0x42, 0xc0, profile, 0, 0, 0, 1, 0x65, 1]);
let sequence = 0;
const unit = (fields = {}) => ({ key: false, replayed: false, damaged: false, captureUs: 5, sequence: (sequence += 1), data: Uint8Array.from([0, 0, 1, 0x41]), ...fields });
const key = (profile = 0x1e, fields = {}) => unit({ key: true, data: sps(profile), ...fields });

function opened() {
  const shown = [];
  const faults = [];
  const stream = new StreamDecoder((picture) => shown.push(picture), (why) => faults.push(why));
  return { stream, shown, faults, get decoder() { return decoders.at(-1); } };
}

test("nothing is decoded before a key unit; a new codec opens a new decoder", () => {
  const { stream } = opened();
  const before = decoders.length;
  stream.handleUnit(unit());
  assert.ok(stream.waiting && decoders.length === before);
  stream.handleUnit(key());
  stream.handleUnit(unit());
  stream.handleUnit(key());
  const [decoder] = decoders.slice(before);
  assert.deepEqual(decoder.chunks.map(({ type }) => type), ["key", "delta", "key"]);
  assert.deepEqual([decoder.how.codec, decoder.how.optimizeForLatency], ["avc1.42c01e", true]);
  stream.handleUnit(key(0x28));
  assert.deepEqual([decoders.length, decoder.state, decoders.at(-1).how.codec], [before + 2, "closed", "avc1.42c028"]);
});

test("a picture has its own unit's facts, also when an earlier one never came out", () => {
  const { stream, shown } = opened();
  stream.handleUnit(key());
  const decoder = decoders.at(-1);
  const damaged = unit({ damaged: true });
  stream.handleUnit(damaged);
  decoder.show();
  assert.deepEqual([shown[0].sequence, shown[0].damaged], [damaged.sequence, true]);
  // The first one's facts are gone.
  assert.equal(decoder.show(decoder.chunks[0]).closed, true);
  assert.equal(shown.length, 1);
});

test("replayed units are decoded, but do not come out", () => {
  const { stream, shown } = opened();
  stream.handleUnit(key(0x1e, { replayed: true }));
  const decoder = decoders.at(-1);
  assert.equal(decoder.show().closed, true);
  stream.handleUnit(unit());
  assert.equal(decoder.show().closed, undefined);
  assert.equal(shown.length, 1);
});

test("a decoder that fails is told once and opened anew by the next key unit", () => {
  const { stream, shown, faults } = opened();
  stream.handleUnit(key());
  const first = decoders.at(-1);
  first.error(new Error("no memory"));
  first.error(new Error("again"));
  assert.deepEqual([faults, stream.waiting], [["no memory"], true]);
  stream.handleUnit(unit());
  stream.handleUnit(key());
  assert.notEqual(decoders.at(-1), first);
  // What the old one still shows is not drawn.
  assert.equal(first.show().closed, true);
  decoders.at(-1).broken = true;
  stream.handleUnit(unit());
  assert.deepEqual([shown, faults.length, stream.waiting], [[], 2, true]);
});

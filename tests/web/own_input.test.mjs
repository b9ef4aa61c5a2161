/** The page's own camera, microphone and loudspeaker: what they say, and that devices are closed. */
import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";
import { Element, Line, hardware, happen, made, pass, settle } from "./page.mjs";
import { load } from "./modules.mjs";

/** The browser's sound, and its worklets. */
const nodes = [];
const context = Object.assign(new EventTarget(), {
  state: "running",
  currentTime: 0,
  outputLatency: 0.03,
  destination: {},
  audioWorklet: { addModule: async () => undefined },
  resume: async () => undefined,
  createGain: () => ({ gain: { setTargetAtTime: (value) => (context.volume = value) }, connect: () => undefined }),
  createMediaStreamSource: () => ({ connect() {}, disconnect: () => (context.cut = true) }),
});
globalThis.AudioContext = function AudioContext() {
  return context;
};
globalThis.AudioWorkletNode = class {
  told = [];
  port = { postMessage: (note) => this.told.push(note) };
  constructor() {
    nodes.push(this);
  }
  connect(next) {
    return next;
  }
};
globalThis.MessageChannel = class {
  port1 = {};
  port2 = {};
};
globalThis.MediaStreamTrackProcessor = class {
  readable = {};
};

/** A device's stream with one track. */
function stream() {
  const track = Object.assign(new Element(), { stop: () => (track.stopped = true) });
  return { track, getTracks: () => [track], getVideoTracks: () => [track] };
}
let given;
beforeEach(() => {
  hardware.devices = Object.assign(new EventTarget(), { getUserMedia: async () => (given = stream()) });
});

const { OwnInput, inputWords } = await load("own_input.js");
const { openCamera } = await load("own_camera.js");
const { OwnMicrophone } = await load("own_microphone.js");
const { SoundPlayer, bindSoundAge } = await load("sound_player.js");
const CAMERA = { index: 0, name: "iss_camera", kind: "video" };

test("a camera is asked for, taken over and given back; its device is closed with it", async () => {
  const camera = new OwnInput(CAMERA, openCamera);
  const states = [];
  camera.onchange = () => states.push(camera.state);
  camera.toggle();
  await settle();
  const { worker } = made;
  assert.deepEqual([camera.stream, worker.told[0].input], [given, CAMERA]);
  worker.tell({ kind: "taken" });
  worker.tell({ kind: "lost" });
  assert.match(inputWords(camera), /server does not answer/);
  worker.tell({ kind: "taken" });
  camera.toggle();
  assert.deepEqual([worker.ended, given.track.stopped, inputWords(camera)], [true, true, "off"]);
  assert.deepEqual(states, ["off", "asking", "asking", "on", "asking", "on", "off"]);
});

test("whatever ends it closes the device and stops its worker", async () => {
  const ends = {
    refused: ({ worker }) => worker.tell({ kind: "refused", why: "another page has it" }),
    unplugged: () => given.track.dispatchEvent(new Event("ended")),
    left: () => happen("pagehide"),
  };
  for (const [name, act] of Object.entries(ends)) {
    const camera = new OwnInput(CAMERA, openCamera);
    await camera.turnOn();
    const { worker } = made;
    act({ worker });
    assert.ok(worker.ended && given.track.stopped, name);
    assert.equal(camera.state, name === "left" ? "off" : "failed", name);
  }
});

test("a device that opens after it was turned off is closed at once", async () => {
  const camera = new OwnInput(CAMERA, openCamera);
  const { worker } = made;
  void camera.turnOn();
  camera.turnOff();
  await settle();
  assert.deepEqual([given.track.stopped, made.worker === worker, camera.state], [true, true, "off"]);
});

test("each refusal of the browser is one line for people", async () => {
  const error = (name) => Object.assign(new Error("x"), { name });
  const reasons = { NotAllowedError: /no permission for the camera/, NotFoundError: /has no camera/, NotReadableError: /does not start/, Odd: /^x$/ };
  for (const [name, words] of Object.entries(reasons)) {
    hardware.devices.getUserMedia = async () => { throw error(name); };
    const camera = new OwnInput(CAMERA, openCamera);
    await camera.turnOn();
    assert.match(camera.words, words);
  }
  hardware.devices = undefined;
  const camera = new OwnInput(CAMERA, openCamera);
  await camera.turnOn();
  assert.match(camera.words, /only on 127\.0\.0\.1 or over HTTPS/);
});

test("the key to talk goes before mute, and turns a microphone on that is muted otherwise", async () => {
  const microphone = new OwnMicrophone({ index: 1, name: "iss_mic", kind: "audio" });
  microphone.talking = true;
  await settle();
  made.worker.tell({ kind: "taken" });
  const node = nodes.at(-1);
  const muted = () => node.told.filter((note) => "muted" in note).at(-1).muted;
  assert.deepEqual([microphone.heard, muted()], [true, false]);
  microphone.talking = false;
  assert.deepEqual([microphone.heard, muted()], [false, true]);
  microphone.muted = false;
  assert.deepEqual([microphone.heard, muted()], [true, false]);
  node.port.onmessage({ data: { peak: 0.5 } });
  assert.equal(microphone.peak, 0.5);
  microphone.turnOff();
  assert.deepEqual([microphone.peak, node.told.at(-1), context.cut], [0, { closed: true }, true]);
});

test("a voice is as old as its sound and the loudspeaker's way; without a device it says so", async () => {
  const line = Object.assign(new Line(), { attachSound: (...words) => (line.attached = words) });
  const player = new SoundPlayer(line, "uplink_voice");
  await player.start();
  assert.equal(line.attached[0], "uplink_voice");
  const tell = (captureUs) => nodes.at(-1).port.onmessage({ data: { peak: 0.25, stockMs: 40, captureUs } });
  tell(line.nowUs() - 100_000);
  // The context's clock goes on.
  context.currentTime = 1;
  pass(2000);
  assert.deepEqual([player.ageMs, player.peak, player.words], [130, 0.25, "plays 70 ms late"]);
  const ages = {};
  bindSoundAge(player, { setOwn: (name, value) => (ages[name] = value) }, "uplink_voice.age_ms");
  pass(200);
  assert.equal(ages["uplink_voice.age_ms"], 130);
  tell(null);
  assert.equal(player.ageMs, null);
  player.volume = 0.5;
  assert.equal(context.volume, 0.5);
  player.muted = true;
  assert.equal(context.volume, 0);
  // The clock stands, so there is no device.
  context.dispatchEvent(new Event("statechange"));
  pass(2000);
  assert.deepEqual([player.peak, player.words], [0, "this machine has no sound device"]);
  context.state = "suspended";
  context.dispatchEvent(new Event("statechange"));
  assert.match(player.words, /press any key/);
});

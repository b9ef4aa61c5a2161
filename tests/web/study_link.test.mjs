/** The connection of a study's page: it comes back by itself, unless another page has the study. */
import assert from "node:assert/strict";
import { test } from "node:test";
import { made, pass } from "./page.mjs";
import { load } from "./modules.mjs";

const { StudyLink } = await load("study_link.js");
const SHOWN = { kind: "study", screen: 4, phase: "start", half_width_m: 0.15, half_height_m: 0.1 };

function opened() {
  const link = new StudyLink();
  const events = [];
  for (const name of ["shown", "frame", "haptic", "lost"]) link.on(name, (event) => events.push([name, event]));
  link.open();
  return { link, events };
}

test("screens and frames are told, and a frame is where the handle is", () => {
  const { link, events } = opened();
  assert.equal(made.socket.url, "wss://host/token/ws");
  link.press(4, false);
  assert.deepEqual(made.socket.sent, []);
  made.socket.open();
  made.socket.hear(SHOWN);
  assert.ok(link.alive && link.hindrance === "");
  assert.deepEqual(link.hello.workspace, { half_width_m: 0.15, half_height_m: 0.1 });
  made.socket.hear({ kind: "frame", x_m: 0.01, y_m: -0.02 });
  assert.deepEqual(events.map(([name]) => name), ["shown", "haptic", "frame"]);
  assert.deepEqual([events[1][1].xM, events[1][1].yM], [[0.01], [-0.02]]);
  link.press(4, true);
  assert.deepEqual(JSON.parse(made.socket.sent[0]), { screen: 4, other: true });
});

test("messages of the hand are numbered in their order", () => {
  const { link } = opened();
  made.socket.open();
  for (const x of [0.5, -0.5]) link.sendHand({ deadMan: true, x, y: 0, buttons: 0 });
  const views = made.socket.sent.map((message) => new DataView(message));
  assert.deepEqual(views.map((view) => [view.getUint8(0), view.getUint32(4, true), view.getFloat32(8, true)]), [[0x82, 1, 0.5], [0x82, 2, -0.5]]);
});

test("a lost server is tried again every second; a study that another page has taken is not", () => {
  const { link, events } = opened();
  const count = made.sockets.length;
  made.socket.open();
  made.socket.hear(SHOWN);
  for (let lost = 1; lost < 4; lost += 1) {
    made.socket.close(1006);
    assert.equal(link.alive, false);
    pass(1000);
    assert.equal(made.sockets.length, count + lost);
  }
  assert.match(events.at(-1)[1], /does not answer/);
  made.socket.close(4001);
  assert.match(link.hindrance, /Another page/);
  pass(60_000);
  assert.equal(made.sockets.length, count + 3);
});

/** The page's side of its seat worker: requests are answered once, and nothing stays open. */
import assert from "node:assert/strict";
import { test } from "node:test";
import { body, clockMs, made, pass, settle } from "./page.mjs";
import { load } from "./modules.mjs";

const { Connection } = await load("connection.js");
const HELLO = { kind: "hello", seat: "space", role: "operator", now_us: 5_000_000, streams: [{ index: 3, name: "uplink_video", kind: "video" }] };
const text = (fields) => ({ kind: "text", text: fields });

function connected() {
  const connection = new Connection();
  const { worker } = made;
  worker.tell({ kind: "heard" });
  worker.tell(text(HELLO));
  return { connection, worker };
}
const asked = (worker) => worker.told.filter(({ kind }) => kind === "request").map((one) => JSON.parse(one.text));

test("each request has a number, and gets the answer of this number, once", async () => {
  const { connection, worker } = connected();
  const answers = [];
  for (const words of ["a", "b"]) void connection.request({ do: "chat", text: words }).then((one) => answers.push(one));
  const [first, second] = asked(worker);
  assert.notEqual(first.request, second.request);
  worker.tell(text({ kind: "answer", request: second.request, ok: true, error: "" }));
  worker.tell(text({ kind: "answer", request: first.request, ok: false, error: "no" }));
  worker.tell(text({ kind: "answer", request: 99, ok: true, error: "" }));
  await settle();
  assert.deepEqual(answers.map(({ request, error }) => [request, error]), [[second.request, ""], [first.request, "no"]]);
});

test("a request without an answer fails: after 10 s, a telecommand after 40 s, and with the connection", async () => {
  const { connection, worker } = connected();
  const errors = [];
  const ask = (request) => connection.request(request).then(({ ok, error }) => errors.push([ok, error]));
  void ask({ do: "chat", text: "" });
  void ask({ do: "command", application: "robot" });
  pass(10_000);
  await settle();
  assert.deepEqual(errors, [[false, "no answer within 10 s"]]);
  pass(30_000);
  await settle();
  assert.equal(errors.length, 2);
  void ask({ do: "chat", text: "" });
  // A silent server may still answer.
  worker.tell({ kind: "lost", why: "silent", reason: "" });
  await settle();
  assert.equal(errors.length, 2);
  worker.tell({ kind: "lost", why: "closed", reason: "" });
  void ask({ do: "chat", text: "" });
  await settle();
  assert.deepEqual(errors.slice(2).map(([, error]) => error).sort(), ["the connection was lost", "the server does not answer"]);
  assert.equal(asked(worker).length, 3);
});

test("a picture is closed after all have drawn it, and the worker hears of it", () => {
  const { connection, worker } = connected();
  const frame = { close: () => (frame.closed = true) };
  const drawn = [];
  const leave = connection.on("frame", (one) => drawn.push([one.of.name, frame.closed]));
  worker.tell({ kind: "frame", stream: 3, frame });
  assert.deepEqual(drawn, [["uplink_video", undefined]]);
  assert.deepEqual([frame.closed, worker.told.at(-1)], [true, { kind: "drawn", stream: 3 }]);
  leave();
  // A stream of another session.
  for (const stream of [3, 7]) {
    const other = { close: () => (other.closed = true) };
    worker.tell({ kind: "frame", stream, frame: other });
    assert.deepEqual([drawn.length, other.closed, worker.told.at(-1).stream], [1, true, stream]);
  }
});

test("the session's clock is that of hello until a ping knows better", () => {
  const connection = new Connection();
  const { worker } = made;
  assert.deepEqual([connection.nowUs(), connection.alive], [null, false]);
  worker.tell(text(HELLO));
  pass(100);
  assert.equal(connection.nowUs(), 5_100_000);
  worker.tell({ kind: "clock", offsetUs: 7, roundTripMs: 3 });
  assert.deepEqual([connection.nowUs(), connection.roundTripMs], [1000 * clockMs() + 7, 3]);
});

test("a new connection voids what was known; a viewer may not act; a refused address is over", () => {
  const { connection, worker } = connected();
  const shown = ["robot", "experiment", "panel", "state"];
  for (const kind of shown) worker.tell(text({ kind }));
  worker.tell(text({ kind: "figures", state: "stopped", figures: {} }));
  assert.ok(shown.every((kind) => connection[kind].kind === kind) && connection.stopped && connection.mayAct);
  worker.tell(text({ ...HELLO, role: "viewer" }));
  assert.deepEqual([connection.robot, connection.experiment, connection.panel, connection.mayAct], [null, null, null, false]);
  worker.tell({ kind: "lost", why: "closed", reason: "" });
  assert.equal(connection.ended, false);
  worker.tell({ kind: "lost", why: "refused", reason: "" });
  worker.tell({ kind: "lost", why: "closed", reason: "" });
  assert.deepEqual([connection.ended, connection.alive], [true, false]);
  assert.notEqual(connection.hindrance, "");
});

test("each kind of text and note is told by its name; a page without pictures asks for none", () => {
  body.plain = true;
  const { connection, worker } = connected();
  assert.match(worker.url, /seat_worker\.js\?plain$/);
  body.plain = false;
  const kinds = ["chat", "commands", "values", "events", "radio", "exercises", "upkeep"];
  const heard = [];
  for (const kind of [...kinds, "fault", "let_go", "preview"]) connection.on(kind, (event) => heard.push([kind, event?.stream]));
  for (const kind of kinds) worker.tell(text({ kind }));
  worker.tell({ kind: "fault", stream: 3, why: "x" });
  worker.tell({ kind: "let_go" });
  worker.tell({ kind: "preview", frame: { close() {} } });
  assert.deepEqual(heard.map(([kind]) => kind), [...kinds, "fault", "let_go", "preview"]);
  assert.equal(heard.at(-3)[1], "uplink_video");
  connection.sendHand({ deadMan: true });
  connection.attachSound("uplink_voice", {});
  assert.deepEqual(worker.told.slice(-2).map(({ kind }) => kind), ["hand", "sound_port"]);
});

/** A partner's WebRTC connection: it restarts a broken way, and else connects again, ever later. */
import assert from "node:assert/strict";
import { beforeEach, test } from "node:test";
import { answers, fetched, pass, settle } from "./page.mjs";
import { load } from "./modules.mjs";

const peers = [];
globalThis.RTCPeerConnection = class extends EventTarget {
  connectionState = "new";
  iceGatheringState = "complete";
  constructor(how) {
    super();
    this.how = how;
    peers.push(this);
  }
  async createOffer(how) {
    return { type: "offer", sdp: `v=0\r\na=ice-ufrag:${how?.iceRestart ? "new" : "old"}\r\na=ice-pwd:p\r\na=mid:0\r\na=candidate:1 here\r\n` };
  }
  async setLocalDescription(description) {
    this.localDescription = description;
  }
  async setRemoteDescription(description) {
    this.remote = description.sdp;
  }
  close() {
    this.closed = true;
  }
  become(state) {
    this.connectionState = state;
    this.dispatchEvent(new Event("connectionstatechange"));
  }
};
const { WhipExchange, restarted } = await load("whip_exchange.js");
const LINK = '<stun:a:1>; rel="ice-server", <https://x>; rel="other", <turn:b?transport=udp>; rel="ice-server"; username="u;1"; credential="s,2"';
const ANSWER = "v=0\r\na=ice-ufrag:far\r\na=ice-pwd:q\r\na=candidate:9 there\r\na=end-of-candidates\r\n";

beforeEach(() => {
  Object.assign(answers, {
    OPTIONS: () => ({ headers: { Link: LINK } }),
    POST: () => ({ headers: { Location: "/session/1" }, text: ANSWER }),
    PATCH: () => ({ text: "a=ice-ufrag:fresh\r\na=ice-pwd:r\r\na=candidate:8 elsewhere\r\n" }),
    DELETE: () => ({}),
  });
  fetched.length = 0;
});

async function connected() {
  const exchange = new WhipExchange("/whep/main", "word", () => undefined);
  await settle();
  peers.at(-1).become("connected");
  return exchange;
}
const methods = () => fetched.splice(0).map(({ method }) => method);

test("it asks for relays, offers, and takes the answer; each request has the token", async () => {
  const exchange = await connected();
  assert.deepEqual(peers.at(-1).how.iceServers, [{ urls: "stun:a:1" }, { urls: "turn:b?transport=udp", username: "u;1", credential: "s,2" }]);
  assert.equal(peers.at(-1).remote, ANSWER);
  assert.ok(fetched.every(({ headers }) => headers.Authorization === "Bearer word"));
  assert.deepEqual([methods(), exchange.fault], [["OPTIONS", "POST"], ""]);
  exchange.close();
  assert.deepEqual([methods(), peers.at(-1).closed], [["DELETE"], true]);
  const { length } = peers;
  pass(60_000);
  await settle();
  assert.equal(peers.length, length);
});

test("a refused connection is tried again, each time after a longer wait, at most 15 s", async () => {
  answers.POST = () => ({ of: { ok: false, status: 503 } });
  const exchange = new WhipExchange("/whep/main", "word", () => undefined);
  await settle();
  assert.match(exchange.fault, /503/);
  for (const waitMs of [500, 1000, 2000, 4000, 8000, 15_000, 15_000]) {
    const { length } = peers;
    pass(waitMs - 1);
    await settle();
    assert.equal(peers.length, length, `before ${waitMs} ms`);
    pass(1);
    await settle();
    assert.equal(peers.length, length + 1);
  }
  exchange.close();
});

test("a way that failed is connected anew, and nothing after its end", async () => {
  const exchange = await connected();
  const peer = peers.at(-1);
  peer.become("failed");
  assert.ok(peer.closed && exchange.fault !== "");
  pass(500);
  await settle();
  assert.notEqual(exchange.peer, peer);
  peers.at(-1).become("connected");
  assert.equal(exchange.fault, "");
  exchange.close();
  // What is under way then ends, too.
  const early = new WhipExchange("/whep/main", "word", () => undefined);
  const { length } = peers;
  early.close();
  await settle();
  pass(60_000);
  await settle();
  assert.equal(peers.length, length);
});

test("a way that breaks is restarted with the same peer; one that heals by itself is not", async () => {
  const exchange = await connected();
  const peer = peers.at(-1);
  methods();
  peer.become("disconnected");
  pass(1000);
  peer.become("connected");
  pass(60_000);
  await settle();
  assert.deepEqual(methods(), []);
  peer.become("disconnected");
  pass(3500);
  await settle();
  const [patch] = fetched;
  assert.equal(patch.method, "PATCH");
  assert.match(patch.body, /a=ice-ufrag:new\r\n.*a=mid:0\r\na=candidate:1 here\r\na=end-of-candidates/s);
  assert.match(peer.remote, /candidate:8 elsewhere/);
  peer.become("connected");
  pass(60_000);
  assert.equal(exchange.peer, peer);
  // A restart that finds no way is a new connection.
  peer.become("disconnected");
  pass(3500);
  await settle();
  pass(10_000);
  await settle();
  assert.ok(peer.closed && exchange.peer !== peer);
  exchange.close();
});

test("a restart replaces credentials and addresses, and nothing else", () => {
  const lines = ["v=0", "m=video 9", "a=ice-ufrag:far", "a=ice-pwd:q", "a=candidate:9 there", "a=sendonly"];
  const found = restarted(lines.join("\r\n"), "a=ice-ufrag:fresh\r\na=ice-pwd:r\r\na=candidate:8 x\r\na=end-of-candidates").split("\r\n");
  assert.deepEqual(found.filter((line) => !/candidate/.test(line)), ["v=0", "m=video 9", "a=ice-ufrag:fresh", "a=ice-pwd:r", "a=sendonly"]);
  assert.deepEqual(found.filter((line) => /candidate/.test(line)), ["a=candidate:8 x", "a=end-of-candidates"]);
});

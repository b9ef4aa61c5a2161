/** What the top line says of the link. */
import assert from "node:assert/strict";
import { test } from "node:test";
import { load } from "./modules.mjs";

const { linkObstacle, linkText, radioSays } = await load("wording.js");

test("a link without protection is named so in every state", () => {
  const states = [
    { connected: true, signal: true },
    { connected: false, signal: true },
    { connected: false, signal: false },
  ];
  const said = (open) => states.map((state) => linkText({ ...state, open }));
  assert.deepEqual(said(false), ["Radio link", "Radio link: signal", "Radio link: no signal"]);
  for (const words of said(true)) assert.match(words, /NOT PROTECTED/);
  assert.equal(new Set(said(true)).size, 3);
});

/** Figures as a page binds them. */
const bound = (values) => ({
  get: (name) => values[name] ?? null,
  number: (name) => (typeof values[name] === "number" ? values[name] : null),
});
const signals = (up, down) => ({ "gateways.space.supervision.signal": up, "gateways.ground.supervision.signal": down });

test("the radio's line follows both ways and the pass", () => {
  const pass = (since, until) => ({ "contact.since_acquisition_s": since, "contact.until_loss_s": until });
  const said = (values) => radioSays(bound(values))?.text;
  assert.equal(said({}), undefined);
  assert.equal(said(signals(true, true)), "carries up and down");
  assert.equal(said({ "gateways.ground.supervision.signal": true }), "carries down");
  assert.equal(said(signals(false, true)), "nothing goes up");
  assert.equal(said(signals(false, false)), "no signal");
  assert.equal(said({ ...signals(true, true), ...pass(10, 90) }), "carries up and down, lost in 01:30");
  assert.match(said({ ...signals(false, false), ...pass(-30, 400) }), /no pass yet: signal in/);
  assert.match(said({ ...signals(false, false), ...pass(500, -5) }), /pass over/);
});

test("a page names why an end sends nothing", () => {
  const head = "gateways.space.supervision";
  const why = "this machine does not send the frames: Network is unreachable";
  assert.equal(linkObstacle(bound({ [`${head}.state`]: "check", [`${head}.why`]: why })), `No link: space: ${why}`);
  assert.equal(linkObstacle(bound({ [`${head}.state`]: "search", [`${head}.why`]: "no signal" })), "");
});

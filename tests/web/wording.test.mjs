/** What the top line says of the link. */
import assert from "node:assert/strict";
import { test } from "node:test";
import { load } from "./modules.mjs";

const { linkText } = await load("wording.js");

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

/** The map and the field: metres to pixels, and what is drawn of what is known. */
import assert from "node:assert/strict";
import { test } from "node:test";
import { Element, look, paper, pass } from "./page.mjs";
import { load } from "./modules.mjs";

const { WorkspaceMap, drawGoal } = await load("workspace_map.js");
const { StudyField } = await load("study_field.js");
const { paint, themeNumber } = await load("palette.js");
const { theme } = await load("theme.js");

const WORKSPACE = { half_width_m: 0.1, half_height_m: 0.05 };
const BOARD = { wall_x_m: 0.08, leds_m: [[0, 0], [0.05, 0.02]], paths_m: { contour: [[0, 0], [0.02, 0], [0.02, 0.02]] }, spring_m: [0.03, 0] };
const HANDLE = { xM: 0, yM: 0, forceXN: 0, forceYN: 0, contact: false, lit: null };
const SCENE = { workspace: WORKSPACE, board: BOARD, handle: null, target: null, start: null };

/** Gives a canvas its size in the page. */
function sized({ canvas }, width, height) {
  Object.assign(canvas, { clientWidth: width, clientHeight: height });
  look(canvas);
  return canvas.context;
}
/** What is drawn by one more `show`. */
function drawn(map, changes = {}) {
  map.canvas.context.calls.length = 0;
  map.show({ ...SCENE, ...changes });
  return map.canvas.context;
}

test("one scale for both axes, whatever the canvas: a circle stays a circle, and all is in sight", () => {
  const map = new WorkspaceMap();
  assert.deepEqual(map.halfPixels(), { x: 0, y: 0 });
  map.show(SCENE);
  assert.equal(map.canvas.context.calls.length, 0);
  for (const [width, height] of [[400, 400], [900, 100], [50, 700]]) {
    sized(map, width, height);
    const { x, y } = map.halfPixels();
    assert.ok(Math.abs(x / y - 2) < 1e-9);
    assert.ok(2 * x <= width && 2 * y <= height && (2 * x > width / 1.2 || 2 * y > height / 1.2));
  }
  // Sharp on this screen.
  assert.deepEqual([map.canvas.width, map.canvas.height], [100, 1400]);
});

test("y is up, and the arrow at the stylus points where the force does", () => {
  const map = new WorkspaceMap();
  sized(map, 448, 448);
  const scale = map.halfPixels().x / WORKSPACE.half_width_m;
  const at = drawn(map, { handle: { ...HANDLE, xM: 0.01, yM: 0.02 } }).of("arc").at(-1);
  assert.deepEqual(at.slice(0, 2).map(Math.round), [224 + 0.01 * scale, 224 - 0.02 * scale].map(Math.round));
  const triangles = (forceYN) => drawn(map, { handle: { ...HANDLE, forceYN } }).of("closePath").length;
  assert.deepEqual([triangles(0.01), triangles(5)], [0, 1]);
  const [, [, tipY]] = drawn(map, { handle: { ...HANDLE, forceYN: 5 } }).of("moveTo").slice(-2);
  assert.ok(tipY < 224);
});

test("a start has a dashed way to it until the handle is there; a lit LED is larger", () => {
  const map = new WorkspaceMap();
  sized(map, 400, 400);
  const dashes = (xM) => drawn(map, { start: { xM: 0, yM: 0 }, handle: { ...HANDLE, xM } }).of("setLineDash").length;
  assert.deepEqual([dashes(0.02), dashes(0.001)], [2, 0]);
  const radii = (lit) => drawn(map, { handle: { ...HANDLE, lit } }).of("arc").slice(0, 2).map(([, , radius]) => radius);
  assert.deepEqual(radii(1), [9, 11]);
  assert.deepEqual(radii(null), [9, 9]);
});

test("a robot of one's own has its marks on the map, and no wall of ours", () => {
  const map = new WorkspaceMap();
  sized(map, 448, 448);
  const marks = [{ name: "bin", x_m: 0.05, y_m: 0, half_width_m: 0.02, half_height_m: 0.01 }];
  const own = drawn(map, { board: { wall_x_m: null, leds_m: [], marks } });
  assert.deepEqual([own.of("fillText").map(([text]) => text), own.of("clip").length], [["bin"], 0]);
  const scale = map.halfPixels().x / WORKSPACE.half_width_m;
  assert.deepEqual(own.of("strokeRect").at(-1).slice(2).map(Math.round), [0.04 * scale, 0.02 * scale].map(Math.round));
  assert.equal(drawn(map).of("clip").length, 1);
});

test("a contour is closed, a place behind the camera is left out, and a spring is pulled", () => {
  const context = new Element().context;
  const at = (xM, yM) => [xM, yM];
  drawGoal(context, { goal: "contour", target_m: null }, BOARD, at, "red");
  assert.deepEqual(context.of("lineTo"), BOARD.paths_m.contour);
  assert.equal(context.of("closePath").length, 1);
  context.calls.length = 0;
  drawGoal(context, { goal: "reach", target_m: [0.01, 0] }, BOARD, () => null, "red");
  assert.deepEqual(context.of("arc"), []);
  drawGoal(context, { goal: "spring", target_m: null }, BOARD, at, "red");
  assert.deepEqual(context.of("arc").map(([x]) => x), [0.03, 0.03]);
});

test("the field of a study draws with the screen's next picture, once for all that came", () => {
  const field = new StudyField();
  const context = sized(field, 300, 200);
  field.fit(WORKSPACE);
  pass(10);
  context.calls.length = 0;
  const frame = { x_m: 0, y_m: 0, target_x_m: 0.05, target_y_m: 0.05, radius_m: 0.01, starting: false, rest: 0 };
  for (const x_m of [0.01, 0.02, 0.03]) field.show({ ...frame, x_m });
  assert.equal(context.calls.length, 0);
  pass(10);
  const [target, dot] = context.of("arc");
  const { x } = field.halfPixels();
  assert.ok(Math.abs(dot[0] - (150 + 0.3 * x)) < 1e-9 && target[1] < 100);
  context.calls.length = 0;
  field.show({ ...frame, starting: true, rest: 0.5 });
  pass(10);
  // Half of the ring that fills while the dot rests.
  const [, ring] = context.of("arc");
  assert.ok(Math.abs(ring[4] - ring[3] - Math.PI) < 1e-9);
});

test("colours are read once a theme", () => {
  assert.equal(theme(), "dark");
  assert.equal(paint("--accent"), "var(--accent)");
  const before = themeNumber();
  paper.documentElement.dataset.theme = "light";
  paper.dispatchEvent(new Event("themechange"));
  assert.deepEqual([theme(), themeNumber()], ["light", before + 1]);
});

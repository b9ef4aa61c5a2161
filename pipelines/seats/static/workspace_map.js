/**
 * A map of the workspace: wall, LEDs, marks, handle, where the hand wants it, and the force as an arrow
 * at the stylus. y is up.
 *
 * @import { BoardText, PanelText } from "./texts.js"
 */
import { FAINT_N, FULL_N, drawArrow } from "./force_view.js";
import { SharpCanvas } from "./sharp_canvas.js";
import { colour } from "./theme.js";

/**
 * What the map shows; lengths in metres.
 * @typedef {object} Scene
 * @property {{half_width_m: number, half_height_m: number}} workspace
 * @property {BoardText} board
 * @property {{xM: number, yM: number, forceXN: number, forceYN: number, contact: boolean, lit: number | null} | null} handle
 * @property {{xM: number, yM: number} | null} target
 * @property {{xM: number, yM: number} | null} start Where a task begins.
 * @property {PanelText | null} [task] What is to be done in a run.
 */

/** The LEDs' names, as they stand on the board. */
export const LED_NAMES = ["1", "2", "3", "A", "B"];
/** Room around the workspace, as a share of it. */
const MARGIN = 1.12;
/** The longest arrow, as a share of the map's smaller side. */
const ARROW = 0.42;

/** This near, the handle is at the start position. */
const START_M = 0.005;

export class WorkspaceMap {
  #sharp = new SharpCanvas(() => this.#handleChange());
  /** @type {Scene | null} */
  #scene = null;
  /** @type {Record<string, string> | null} */
  #colours = null;

  get canvas() {
    return this.#sharp.canvas;
  }

  /** How many CSS pixels the half workspace is. */
  halfPixels() {
    const { half_width_m, half_height_m } = this.#scene?.workspace ?? { half_width_m: 1, half_height_m: 1 };
    const scale = this.#scale();
    return { x: half_width_m * scale, y: half_height_m * scale };
  }

  /** @param {Scene} scene */
  show(scene) {
    this.#scene = scene;
    this.#draw(scene);
  }

  #handleChange() {
    this.#colours = null;
    if (this.#scene !== null) this.#draw(this.#scene);
  }

  /** CSS pixels a metre. */
  #scale() {
    const { width, height } = this.#sharp;
    const { half_width_m, half_height_m } = this.#scene?.workspace ?? { half_width_m: 1, half_height_m: 1 };
    return Math.min(width / half_width_m, height / half_height_m) / (2 * MARGIN);
  }

  /** @param {Scene} scene */
  #draw({ workspace, board, handle, target, start, task = null }) {
    const { width, height } = this.#sharp;
    if (width === 0) return;
    const context = this.#sharp.cleared();
    const names = ["--line", "--quiet", "--text", "--accent", "--force", "--good", "--raised", "--panel"];
    this.#colours ??= Object.fromEntries(names.map((name) => [name, colour(name)]));
    const paint = (/** @type {string} */ name) => this.#colours?.[name] ?? "";
    const scale = this.#scale();
    /** @param {number} xM */
    const across = (xM) => width / 2 + xM * scale;
    /** @param {number} yM */
    const down = (yM) => height / 2 - yM * scale;
    const [halfX, halfY] = [workspace.half_width_m * scale, workspace.half_height_m * scale];

    // The workspace and its middle.
    context.fillStyle = paint("--raised");
    context.fillRect(width / 2 - halfX, height / 2 - halfY, 2 * halfX, 2 * halfY);
    context.strokeStyle = paint("--line");
    context.lineWidth = 1;
    context.strokeRect(width / 2 - halfX, height / 2 - halfY, 2 * halfX, 2 * halfY);
    context.beginPath();
    context.moveTo(width / 2 - halfX, height / 2);
    context.lineTo(width / 2 + halfX, height / 2);
    context.moveTo(width / 2, height / 2 - halfY);
    context.lineTo(width / 2, height / 2 + halfY);
    context.stroke();

    for (const mark of board.marks ?? []) {
      const [x, y] = [across(mark.x_m), down(mark.y_m)];
      const [wide, high] = [Math.max(4, mark.half_width_m * scale), Math.max(4, mark.half_height_m * scale)];
      context.strokeStyle = context.fillStyle = paint("--quiet");
      context.lineWidth = 1.5;
      context.strokeRect(x - wide, y - high, 2 * wide, 2 * high);
      context.font = "11px system-ui, sans-serif";
      context.textAlign = xRoom(x, width);
      context.textBaseline = "bottom";
      context.fillText(mark.name, x, y - high - 2);
    }

    if (board.wall_x_m !== null) this.#drawWall(context, across(board.wall_x_m), halfX, halfY, paint);

    // The LEDs, with their names.
    context.font = "11px system-ui, sans-serif";
    context.textAlign = "center";
    context.textBaseline = "middle";
    board.leds_m.forEach(([xM, yM], index) => {
      const lit = handle?.lit === index;
      context.beginPath();
      context.arc(across(xM), down(yM), lit ? 11 : 9, 0, 2 * Math.PI);
      context.fillStyle = lit ? paint("--good") : paint("--panel");
      context.fill();
      context.lineWidth = 1.5;
      context.strokeStyle = lit ? paint("--good") : paint("--quiet");
      context.stroke();
      context.fillStyle = lit ? paint("--panel") : paint("--text");
      context.fillText(LED_NAMES[index] ?? "", across(xM), down(yM) + 0.5);
    });

    // The LED panel, small: which of them is lit, the picture shows.
    context.font = "9px system-ui, sans-serif";
    (board.lights_m ?? []).forEach(([xM, yM], index) => {
      context.beginPath();
      context.arc(across(xM), down(yM), 6, 0, 2 * Math.PI);
      context.lineWidth = 1;
      context.strokeStyle = paint("--quiet");
      context.stroke();
      context.fillStyle = paint("--quiet");
      context.fillText(String(index), across(xM), down(yM) + 0.5);
    });
    context.font = "11px system-ui, sans-serif";

    if (task !== null && task.goal !== "") drawGoal(context, task, board, (xM, yM) => [across(xM), down(yM)], paint("--force"));
    if (start !== null) {
      const [x, y] = [across(start.xM), down(start.yM)];
      context.strokeStyle = context.fillStyle = paint("--accent");
      context.lineWidth = 2.5;
      context.beginPath();
      context.arc(x, y, Math.max(8, START_M * scale), 0, 2 * Math.PI);
      context.stroke();
      context.textAlign = xRoom(x, width);
      context.fillText("start", x, y - Math.max(8, START_M * scale) - 8);
      if (handle !== null && Math.hypot(handle.xM - start.xM, handle.yM - start.yM) > START_M) {
        context.setLineDash([5, 5]);
        context.lineWidth = 1.5;
        context.beginPath();
        context.moveTo(across(handle.xM), down(handle.yM));
        context.lineTo(x, y);
        context.stroke();
        context.setLineDash([]);
      }
    }

    if (target !== null) {
      const [x, y] = [across(target.xM), down(target.yM)];
      context.strokeStyle = paint("--accent");
      context.lineWidth = 1.5;
      context.beginPath();
      context.moveTo(x - 14, y);
      context.lineTo(x + 14, y);
      context.moveTo(x, y - 14);
      context.lineTo(x, y + 14);
      context.stroke();
    }
    if (handle === null) return;
    const [x, y] = [across(handle.xM), down(handle.yM)];
    context.beginPath();
    context.arc(x, y, 7, 0, 2 * Math.PI);
    context.fillStyle = target === null ? paint("--quiet") : paint("--accent");
    context.fill();
    context.lineWidth = 2;
    context.strokeStyle = handle.contact ? paint("--force") : paint("--panel");
    context.stroke();
    if (Math.hypot(handle.forceXN, handle.forceYN) < FAINT_N) return;
    const newton = (ARROW * Math.min(width, height)) / FULL_N;
    context.strokeStyle = context.fillStyle = paint("--force");
    drawArrow(context, x, y, handle.forceXN * newton, -handle.forceYN * newton, 4);
  }

  /**
   * The wall, hatched on its solid side.
   * @param {CanvasRenderingContext2D} context @param {number} wall @param {number} halfX @param {number} halfY
   * @param {(name: string) => string} paint
   */
  #drawWall(context, wall, halfX, halfY, paint) {
    const { width, height } = this.#sharp;
    context.save();
    context.beginPath();
    context.rect(wall, height / 2 - halfY, Math.max(0, width / 2 + halfX - wall), 2 * halfY);
    context.clip();
    context.strokeStyle = paint("--quiet");
    context.globalAlpha = 0.45;
    context.beginPath();
    for (let y = -halfX - halfY; y < halfX + halfY; y += 9) {
      context.moveTo(wall, height / 2 + y + 40);
      context.lineTo(wall + 2 * halfX, height / 2 + y + 40 - 2 * halfX);
    }
    context.stroke();
    context.restore();
    context.strokeStyle = paint("--text");
    context.lineWidth = 3;
    context.beginPath();
    context.moveTo(wall, height / 2 - halfY);
    context.lineTo(wall, height / 2 + halfY);
    context.stroke();
  }
}

/**
 * Draws what a task is about: the way, and what is to be reached now.
 * @param {CanvasRenderingContext2D} context @param {PanelText} task @param {BoardText} board
 * @param {(xM: number, yM: number) => [number, number] | null} at Where a place is drawn. @param {string} paint
 */
export function drawGoal(context, { goal, target_m: target }, board, at, paint) {
  const way = board.paths_m?.[goal] ?? [];
  context.save();
  context.strokeStyle = context.fillStyle = paint;
  context.lineWidth = 2;
  context.setLineDash(target === null ? [] : [3, 5]);
  context.beginPath();
  for (const [xM, yM] of way) context.lineTo(...(at(xM, yM) ?? [NaN, NaN]));
  if (goal === "contour") context.closePath();
  context.stroke();
  context.setLineDash([]);
  const there = goal === "spring" ? (board.spring_m ?? null) : target;
  const drawn = there === null ? null : at(...there);
  if (drawn !== null) {
    const [x, y] = drawn;
    context.beginPath();
    context.arc(x, y, 5, 0, 2 * Math.PI);
    context.fill();
    context.lineWidth = 2.5;
    context.beginPath();
    context.arc(x, y, 11, 0, 2 * Math.PI);
    context.stroke();
    if (goal === "spring") drawArrow(context, x - 14, y, -26, 0, 4);
  }
  context.restore();
}

/** On which side of `x` a word has room. @param {number} x @param {number} width @returns {CanvasTextAlign} */
const xRoom = (x, width) => (x < 30 ? "left" : x > width - 30 ? "right" : "center");

/**
 * `<robot-map>`: the task board from above the robot: where its stylus and the joystick's handle
 * are, the force on the stylus, what it touches and which LED is lit.
 *
 * @import { HapticTrace } from "./haptic_trace.js"
 * @import { BoardText } from "./texts.js"
 */
import { fitCanvas } from "./canvas_size.js";
import { startDrawing, stopDrawing } from "./drawing_loop.js";
import { Value } from "./haptic_trace.js";
import { make, setText } from "./make.js";
import { token, tokenGeneration } from "./tokens.js";
import { HapticFlag, litLed } from "./wire.js";

/** A force of this size is drawn as an arrow over half the board's height. */
const FULL_FORCE_N = 10;
/** Weaker than this no arrow is drawn: it would only tremble. */
const LEAST_FORCE_N = 0.05;
/** Without a row for this long, an end is drawn as gone. */
const SILENT_US = 300_000;

export class RobotMap extends HTMLElement {
  /** @type {BoardText | null} */
  #board = null;
  /** The traces of joystick and robot; set before the first `update`.
   * @type {readonly HapticTrace[]}
   */
  traces = [];
  #nowUs = NaN;
  #drawn = "";
  #canvas = make("canvas");
  #context = /** @type {CanvasRenderingContext2D} */ (this.#canvas.getContext("2d"));
  #contact = make("output", { class: "contact" }, "–");
  #force = make("span", { class: "number" }, "–");
  #place = make("span", { class: "number" }, "–");

  connectedCallback() {
    if (this.childElementCount === 0) {
      this.append(
        this.#canvas,
        make(
          "p",
          { class: "map-facts" },
          this.#contact,
          make("span", {}, this.#force, " N"),
          make("span", {}, this.#place, " mm"),
        ),
      );
      this.#canvas.setAttribute("role", "img");
      this.#canvas.setAttribute("aria-label", "Task board with the robot's stylus");
    }
    startDrawing(this);
  }

  disconnectedCallback() {
    stopDrawing(this);
  }

  /** @param {BoardText} board */
  set board(board) {
    this.#board = board;
    this.#drawn = "";
  }

  /** @param {number} nowUs The session's clock. */
  update(nowUs) {
    this.#nowUs = nowUs;
  }

  /** Bring the canvas up to date; called by the drawing loop. */
  draw() {
    const [joystick, robot] = this.traces;
    const board = this.#board;
    if (board === null || joystick === undefined || robot === undefined) return;
    const resized = fitCanvas(this.#canvas);
    if (this.#canvas.width === 0) return;
    const what = [joystick.appended, robot.appended, this.#live(joystick), this.#live(robot), tokenGeneration()].join();
    if (!resized && what === this.#drawn) return;
    this.#drawn = what;

    const flags = robot.newest < 0 ? 0 : robot.flags[robot.newest];
    const lit = this.#live(robot) ? litLed(flags) : null;
    const { width, height } = this.#canvas;
    const scale = Math.min((width - 16) / board.width_m, (height - 16) / board.height_m);
    const context = this.#context;
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.clearRect(0, 0, width, height);
    context.setTransform(1, 0, 0, 1, width / 2, height / 2);
    this.#drawBoard(board, scale, lit);
    this.#drawEnd(joystick, scale, token("--end-joystick"), false);
    this.#drawEnd(robot, scale, token("--end-robot"), (flags & HapticFlag.CONTACT) !== 0);
    this.#facts(robot, flags);
  }

  /** Whether an end sent a row lately. @param {HapticTrace} trace */
  #live(trace) {
    return trace.newest >= 0 && this.#nowUs - trace.timesUs[trace.newest] < SILENT_US;
  }

  /** @param {BoardText} board @param {number} scale @param {number | null} lit */
  #drawBoard(board, scale, lit) {
    const context = this.#context;
    const [halfWidth, halfHeight] = [(board.width_m / 2) * scale, (board.height_m / 2) * scale];
    context.lineWidth = 1;
    context.fillStyle = token("--surface-2");
    context.strokeStyle = token("--line");
    context.fillRect(-halfWidth, -halfHeight, 2 * halfWidth, 2 * halfHeight);
    context.strokeRect(-halfWidth, -halfHeight, 2 * halfWidth, 2 * halfHeight);
    const wall = board.wall_x_m * scale;
    context.fillStyle = token("--line");
    context.fillRect(wall, -halfHeight, halfWidth - wall, 2 * halfHeight);
    context.font = `${Math.round(Math.max(10, scale * 0.011))}px ${token("--font") || "sans-serif"}`;
    context.textAlign = "center";
    context.textBaseline = "middle";
    board.leds_m.forEach(([x, y], index) => {
      context.beginPath();
      context.arc(x * scale, -y * scale, 0.012 * scale, 0, 2 * Math.PI);
      context.fillStyle = index === lit ? token("--warn") : token("--surface");
      context.strokeStyle = token("--ink-2");
      context.lineWidth = index === lit ? 3 : 1;
      context.fill();
      context.stroke();
      context.fillStyle = index === lit ? token("--surface") : token("--ink-2");
      context.fillText(String(index + 1), x * scale, -y * scale);
    });
  }

  /** The joystick as an open square, the robot as a filled dot with its force.
   * @param {HapticTrace} trace @param {number} scale @param {string} colour
   * @param {boolean} contact
   */
  #drawEnd(trace, scale, colour, contact) {
    if (!this.#live(trace)) return;
    const value = (/** @type {number} */ which) => trace.values[which][trace.newest];
    const [x, y] = [value(Value.X_M) * scale, -value(Value.Y_M) * scale];
    const context = this.#context;
    const size = Math.max(5, 0.005 * scale);
    context.strokeStyle = colour;
    context.fillStyle = colour;
    context.lineWidth = Math.max(2, 0.0015 * scale);
    if (trace === this.traces[0]) {
      context.strokeRect(x - 1.4 * size, y - 1.4 * size, 2.8 * size, 2.8 * size);
      return;
    }
    if (contact) {
      context.beginPath();
      context.arc(x, y, 2.4 * size, 0, 2 * Math.PI);
      context.stroke();
    }
    context.beginPath();
    context.arc(x, y, size, 0, 2 * Math.PI);
    context.fill();
    this.#drawForce(x, y, value(Value.FORCE_X_N), -value(Value.FORCE_Y_N), size);
  }

  /** @param {number} x @param {number} y @param {number} fx @param {number} fy @param {number} size */
  #drawForce(x, y, fx, fy, size) {
    const force = Math.hypot(fx, fy);
    if (force < LEAST_FORCE_N) return;
    const context = this.#context;
    const long = (Math.min(1, force / FULL_FORCE_N) * this.#canvas.height) / 2 + 2 * size;
    const [ux, uy] = [fx / force, fy / force];
    const [tipX, tipY] = [x + ux * long, y + uy * long];
    context.strokeStyle = token("--ink");
    context.fillStyle = token("--ink");
    context.beginPath();
    context.moveTo(x, y);
    context.lineTo(tipX - ux * size, tipY - uy * size);
    context.stroke();
    context.beginPath();
    context.moveTo(tipX, tipY);
    context.lineTo(tipX - 2 * size * ux - size * uy, tipY - 2 * size * uy + size * ux);
    context.lineTo(tipX - 2 * size * ux + size * uy, tipY - 2 * size * uy - size * ux);
    context.fill();
  }

  /** @param {HapticTrace} robot @param {number} flags */
  #facts(robot, flags) {
    const live = this.#live(robot);
    const value = (/** @type {number} */ which) => (live ? robot.values[which][robot.newest] : NaN);
    const led = litLed(flags);
    const touching = (flags & HapticFlag.CONTACT) !== 0;
    const words = touching ? (led === null ? "contact" : `contact, LED ${led + 1}`) : "free";
    setText(this.#contact, live ? words : "no samples");
    this.#contact.dataset.contact = String(live && touching);
    const force = Math.hypot(value(Value.FORCE_X_N), value(Value.FORCE_Y_N));
    setText(this.#force, live ? force.toFixed(2) : "–");
    const [x, y] = [value(Value.X_M) * 1000, value(Value.Y_M) * 1000];
    setText(this.#place, live ? `${x.toFixed(1)}, ${y.toFixed(1)}` : "–");
  }
}

customElements.define("robot-map", RobotMap);

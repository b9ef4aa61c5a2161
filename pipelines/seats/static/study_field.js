/**
 * Draws the field of a study: the dot, and the circle that it is to be in. y is up.
 *
 * @import { StudyFrame, StudyShown } from "./texts.js"
 */
import { paint } from "./palette.js";
import { SharpCanvas } from "./sharp_canvas.js";

/** Room around the field, as a share of it. */
const MARGIN = 1.04;
const DOT_PX = 6;

export class StudyField {
  #sharp = new SharpCanvas(() => this.#draw());
  #half = { x: 1, y: 1 };
  /** @type {StudyFrame | null} */
  #frame = null;
  #asked = false;

  get canvas() {
    return this.#sharp.canvas;
  }

  /** How many CSS pixels the half field is. */
  halfPixels() {
    const scale = this.#scale();
    return { x: this.#half.x * scale, y: this.#half.y * scale };
  }

  /** @param {StudyShown} shown */
  fit({ half_width_m, half_height_m }) {
    this.#half = { x: half_width_m, y: half_height_m };
    this.show(null);
  }

  /** Draws this with the screen's next picture. @param {StudyFrame | null} frame */
  show(frame) {
    this.#frame = frame;
    if (this.#asked) return;
    this.#asked = true;
    requestAnimationFrame(() => {
      this.#asked = false;
      this.#draw();
    });
  }

  /** CSS pixels a metre. */
  #scale() {
    const { width, height } = this.#sharp;
    return Math.min(width / this.#half.x, height / this.#half.y) / (2 * MARGIN);
  }

  #draw() {
    const { width, height } = this.#sharp;
    if (width === 0) return;
    const context = this.#sharp.cleared();
    const half = this.halfPixels();
    context.fillStyle = paint("--raised");
    context.strokeStyle = paint("--line");
    context.fillRect(width / 2 - half.x, height / 2 - half.y, 2 * half.x, 2 * half.y);
    context.strokeRect(width / 2 - half.x, height / 2 - half.y, 2 * half.x, 2 * half.y);
    const frame = this.#frame;
    if (frame === null) return;
    const scale = this.#scale();
    /** @param {number} xM @param {number} yM @param {number} radius */
    const circle = (xM, yM, radius, turns = 1) => {
      context.beginPath();
      const top = -Math.PI / 2;
      context.arc(width / 2 + xM * scale, height / 2 - yM * scale, radius, top, top + 2 * Math.PI * turns);
    };
    const radius = frame.radius_m * scale;
    context.lineWidth = 2;
    context.fillStyle = context.strokeStyle = paint(frame.starting ? "--accent" : "--good");
    circle(frame.target_x_m, frame.target_y_m, frame.starting ? Math.max(radius, 2 * DOT_PX) : radius);
    if (frame.starting) {
      context.stroke();
      context.lineWidth = 5;
      circle(frame.target_x_m, frame.target_y_m, Math.max(radius, 2 * DOT_PX) + 5, frame.rest);
      context.stroke();
    } else {
      context.fill();
    }
    context.fillStyle = paint("--text");
    context.lineWidth = 2;
    context.strokeStyle = paint("--panel");
    circle(frame.x_m, frame.y_m, DOT_PX);
    context.fill();
    context.stroke();
  }
}

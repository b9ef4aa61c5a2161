/**
 * `<force-dial>`: the force as an arrow in a ring, beside the picture.
 *
 * It lies over the picture, so its colours are those of the dark theme in both.
 *
 * @import { Seat } from "./seat.js"
 */
import { make, setText } from "./dom.js";
import { FAINT_N, drawArrow, forceShare } from "./force_view.js";
import { NewestRow } from "./newest_row.js";
import { onNextFrame } from "./next_frame.js";
import { SharpCanvas } from "./sharp_canvas.js";

class ForceDial extends HTMLElement {
  /** @param {Seat} seat */
  follow({ connection }) {
    const newest = new NewestRow(connection, "joystick");
    const words = make("span");
    const redraw = onNextFrame(() => draw(sharp, words, newest));
    const sharp = new SharpCanvas(redraw);
    newest.onchange = redraw;
    this.append(sharp.canvas, words);
  }
}

/** @param {SharpCanvas} sharp @param {HTMLElement} words @param {NewestRow} newest */
function draw(sharp, words, { row, forceN }) {
  setText(words, forceN === null ? "–" : `${forceN.toFixed(1)} N`);
  const context = sharp.cleared();
  const [x, y] = [sharp.width / 2, sharp.height / 2];
  const radius = Math.max(0, Math.min(x, y) - 3);
  context.beginPath();
  context.arc(x, y, radius, 0, 2 * Math.PI);
  context.fillStyle = "rgb(5 8 11 / 60%)";
  context.fill();
  context.lineWidth = 2;
  context.strokeStyle = row?.contact === true ? "#ff9d4d" : "#9db0c0";
  context.stroke();
  context.beginPath();
  context.arc(x, y, 3, 0, 2 * Math.PI);
  context.fillStyle = "#9db0c0";
  context.fill();
  if (row === null || forceN === null || forceN < FAINT_N) return;
  const length = (forceShare(forceN) * radius) / forceN;
  context.strokeStyle = context.fillStyle = "#ff9d4d";
  drawArrow(context, x, y, row.forceXN * length, -row.forceYN * length, 5);
}

customElements.define("force-dial", ForceDial);

/** How force is drawn and put into words, the same everywhere on a page. */

/** The force that fills the bar: the most that a handle without motors is given. */
export const FULL_N = 10;
/** Less than this is noise. */
export const FAINT_N = 0.05;

/** @param {number} forceN */
export const forceShare = (forceN) => Math.min(1, forceN / FULL_N);

/**
 * Draws an arrow from (x, y) along (dx, dy), in pixels, y down.
 * @param {CanvasRenderingContext2D} context
 * @param {number} x @param {number} y @param {number} dx @param {number} dy
 * @param {number} width
 */
export function drawArrow(context, x, y, dx, dy, width) {
  const length = Math.hypot(dx, dy);
  if (length < 1) return;
  const head = Math.min(length, 3.2 * width);
  const [ux, uy] = [dx / length, dy / length];
  const [neckX, neckY] = [x + dx - ux * head, y + dy - uy * head];
  context.lineWidth = width;
  context.lineCap = "round";
  context.beginPath();
  context.moveTo(x, y);
  context.lineTo(neckX, neckY);
  context.stroke();
  context.beginPath();
  context.moveTo(x + dx, y + dy);
  context.lineTo(neckX - uy * head * 0.55, neckY + ux * head * 0.55);
  context.lineTo(neckX + uy * head * 0.55, neckY - ux * head * 0.55);
  context.closePath();
  context.fill();
}

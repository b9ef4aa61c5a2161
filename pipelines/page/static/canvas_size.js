/** Keeps a canvas as large as its box in device pixels, so that lines are sharp. */

/**
 * Fit a canvas to its box. Its content is lost if this returns true.
 *
 * @param {HTMLCanvasElement} canvas
 * @param {number} [mostColumns] the largest width, in pixels
 * @returns {boolean} whether its size changed
 */
export function fitCanvas(canvas, mostColumns = 4096) {
  const scale = Math.min(window.devicePixelRatio || 1, 2);
  const width = Math.min(Math.round(canvas.clientWidth * scale), mostColumns);
  const height = Math.round(canvas.clientHeight * scale);
  if (width === 0 || height === 0 || (canvas.width === width && canvas.height === height)) {
    return false;
  }
  canvas.width = width;
  canvas.height = height;
  return true;
}

/**
 * One loop for all charts: at most 15 times a second, and only what can be seen. The main thread
 * belongs to the pictures; a chart may be 70 ms behind.
 */

const STEP_MS = 1000 / 15;

/**
 * @typedef {Element & {draw: () => void}} Drawable `draw` brings its canvas up to date
 */

/** @type {Set<Drawable>} */
const drawables = new Set();
/** @type {WeakSet<Element>} */
const seen = new WeakSet();
let running = false;

const watcher = new IntersectionObserver((entries) => {
  for (const entry of entries) {
    if (entry.isIntersecting) seen.add(entry.target);
    else seen.delete(entry.target);
  }
});

/** Begin to draw an element while it can be seen.
 * @param {Drawable} drawable
 */
export function startDrawing(drawable) {
  drawables.add(drawable);
  watcher.observe(drawable);
  if (!running) {
    running = true;
    next();
  }
}

/** @param {Drawable} drawable */
export function stopDrawing(drawable) {
  drawables.delete(drawable);
  watcher.unobserve(drawable);
  seen.delete(drawable);
}

function next() {
  // A hidden page gets no animation frames, and so draws nothing.
  setTimeout(() => requestAnimationFrame(drawAll), STEP_MS);
}

function drawAll() {
  for (const drawable of drawables) if (seen.has(drawable)) drawable.draw();
  running = drawables.size > 0;
  if (running) next();
}

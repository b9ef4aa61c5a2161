/**
 * One loop for all charts: at most 15 times a second, and only what can be seen. The main thread
 * belongs to the pictures; a chart may be 70 ms behind.
 */

const STEP_MS = 1000 / 15;

/** @type {Map<Element, () => void>} */
const drawers = new Map();
/** @type {Set<Element>} */
const seen = new Set();

const watcher = new IntersectionObserver((entries) => {
  for (const { isIntersecting, target } of entries) {
    if (isIntersecting) seen.add(target);
    else seen.delete(target);
  }
});

/** Calls `draw` again and again while the element can be seen. @param {Element} element @param {() => void} draw */
export function drawOften(element, draw) {
  drawers.set(element, draw);
  watcher.observe(element);
  if (drawers.size === 1) next();
}

function next() {
  // A hidden page gets no animation frames, and so draws nothing.
  setTimeout(() => requestAnimationFrame(drawAll), STEP_MS);
}

function drawAll() {
  for (const element of seen) drawers.get(element)?.();
  next();
}

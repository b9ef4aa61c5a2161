/**
 * Steers with mouse, pen or finger: a press is the dead-man button, and dragging moves the handle
 * from where it is; on the picture of a robot with a head, the axes `pan` and `tilt`.
 *
 * @import { HandControl } from "./hand_control.js"
 */

/** The raw event does not wait for the next frame; it comes up to 1000 times a second. */
const MOVE = "onpointerrawupdate" in globalThis ? "pointerrawupdate" : "pointermove";

/** @typedef {{pan: number, tilt: number}} Head The places of its axes behind x and y; -1 without one. */

/**
 * @param {HTMLElement} surface Where it may be pressed.
 * @param {HandControl} control
 * @param {() => {x: number, y: number}} pixels How many pixels the half workspace is.
 * @param {() => Head} [head] What is moved instead of x and y, if there is any.
 */
export function steerByPointer(surface, control, pixels, head = () => ({ pan: -1, tilt: -1 })) {
  surface.addEventListener("pointerdown", (event) => {
    if (!event.isPrimary || event.button !== 0) return;
    if (!control.press("pointer")) return;
    event.preventDefault();
    drag(surface, control, pixels, head(), event);
  });
  surface.addEventListener("contextmenu", (event) => {
    if (control.source === "pointer") event.preventDefault();
  });
}

/**
 * From a press until its release. The window listens, because a browser may take the capture away
 * although the button is still held; without capture, leaving the window is a release.
 * @param {HTMLElement} surface @param {HandControl} control
 * @param {() => {x: number, y: number}} pixels @param {Head} head @param {PointerEvent} press
 */
function drag(surface, control, pixels, { pan, tilt }, press) {
  const turns = pan >= 0 || tilt >= 0;
  const from = turns ? { x: control.axisTarget(pan) ?? 0, y: control.axisTarget(tilt) ?? 0 } : (control.target ?? { x: 0, y: 0 });
  const end = new AbortController();
  const listener = { signal: end.signal, capture: true };
  const release = () => {
    end.abort();
    control.release("pointer");
  };
  /** Calls `act` for this pointer only. @param {(event: PointerEvent) => void} act */
  const mine = (act) => (/** @type {Event} */ event) => {
    if (event instanceof PointerEvent && event.pointerId === press.pointerId) act(event);
  };
  const move = mine((event) => {
    // Another window may have seen the release.
    if (event.buttons === 0) {
      release();
      return;
    }
    const scale = pixels();
    const x = from.x + (event.clientX - press.clientX) / scale.x;
    const y = from.y - (event.clientY - press.clientY) / scale.y;
    if (!turns) control.move("pointer", x, y);
    if (pan >= 0) control.moveAxis(pan, x);
    if (tilt >= 0) control.moveAxis(tilt, y);
  });
  const leave = mine((event) => {
    if (event.relatedTarget === null && !surface.hasPointerCapture(press.pointerId)) release();
  });
  addEventListener(MOVE, move, listener);
  addEventListener("pointerup", mine(release), listener);
  addEventListener("pointercancel", mine(release), listener);
  addEventListener("pointerout", leave, listener);
  surface.setPointerCapture(press.pointerId);
}

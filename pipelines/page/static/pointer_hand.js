/**
 * Steers with mouse, pen or finger: a press is the dead-man switch, and dragging moves the handle
 * from where it is.
 *
 * @import { HandControl } from "./hand_control.js"
 */

/**
 * @param {HTMLElement} surface Where it may be pressed.
 * @param {HandControl} control
 * @param {() => {x: number, y: number}} pixels How many pixels the half workspace is.
 */
export function steerByPointer(surface, control, pixels) {
  /** @type {{id: number, x: number, y: number, fromX: number, fromY: number} | null} */
  let drag = null;

  surface.addEventListener("pointerdown", (event) => {
    if (!event.isPrimary || event.button !== 0) return;
    if (!control.press("pointer")) return;
    event.preventDefault();
    surface.setPointerCapture(event.pointerId);
    const { x, y } = control.target ?? { x: 0, y: 0 };
    drag = { id: event.pointerId, x: event.clientX, y: event.clientY, fromX: x, fromY: y };
  });

  /** @param {PointerEvent} event */
  const move = (event) => {
    if (drag === null || event.pointerId !== drag.id) return;
    const scale = pixels();
    control.move(
      "pointer",
      drag.fromX + (event.clientX - drag.x) / scale.x,
      drag.fromY - (event.clientY - drag.y) / scale.y,
    );
  };
  // The raw event does not wait for the next frame; it comes up to 1000 times a second.
  const raw = "onpointerrawupdate" in globalThis;
  surface.addEventListener(raw ? "pointerrawupdate" : "pointermove", (event) => {
    move(/** @type {PointerEvent} */ (event));
  });

  /** @param {PointerEvent} event */
  const release = (event) => {
    if (drag === null || event.pointerId !== drag.id) return;
    drag = null;
    control.release("pointer");
  };
  surface.addEventListener("pointerup", release);
  surface.addEventListener("pointercancel", release);
  surface.addEventListener("lostpointercapture", release);
  surface.addEventListener("contextmenu", (event) => {
    if (control.source === "pointer") event.preventDefault();
  });
}

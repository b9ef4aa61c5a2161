/**
 * Returns a function that has `draw` called once before the next frame, however often it is called.
 *
 * A page that asks for a frame only when something changed costs nothing while it stands still.
 * @param {() => void} draw
 */
export function onNextFrame(draw) {
  let asked = false;
  return () => {
    if (asked) return;
    asked = true;
    requestAnimationFrame(() => {
      asked = false;
      draw();
    });
  };
}

/**
 * Keeps a canvas as sharp as the screen: its context counts in CSS pixels, whatever the screen has.
 */
export class SharpCanvas {
  canvas = document.createElement("canvas");
  #context;
  width = 0;
  height = 0;

  /** @param {() => void} redraw Called when the size or the theme has changed. */
  constructor(redraw) {
    const context = this.canvas.getContext("2d");
    if (context === null) throw new Error("no 2D canvas");
    this.#context = context;
    new ResizeObserver(() => {
      const { clientWidth, clientHeight } = this.canvas;
      const scale = devicePixelRatio;
      this.width = clientWidth;
      this.height = clientHeight;
      this.canvas.width = Math.round(clientWidth * scale);
      this.canvas.height = Math.round(clientHeight * scale);
      redraw();
    }).observe(this.canvas);
    document.addEventListener("themechange", redraw);
  }

  /** The context, scaled to CSS pixels and cleared. */
  cleared() {
    const context = this.#context;
    context.setTransform(devicePixelRatio, 0, 0, devicePixelRatio, 0, 0);
    context.clearRect(0, 0, this.width, this.height);
    return context;
  }
}

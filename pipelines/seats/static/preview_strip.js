/**
 * `<preview-strip>`: all cameras' inputs small; those of the selected camera are marked. Which one
 * is selected is the operator's choice alone.
 *
 * @import { Seat } from "./seat.js"
 * @import { CameraText, PreviewText } from "./texts.js"
 */
import { make, setAttribute, setText } from "./dom.js";
import { nameText } from "./wording.js";

/** Without a picture for this long, an input counts as silent. They come five times a second. */
const SILENT_MS = 1500;

/**
 * @typedef {object} Cell
 * @property {string} input
 * @property {HTMLElement} figure
 * @property {HTMLCanvasElement} canvas
 * @property {CanvasRenderingContext2D} context
 * @property {HTMLElement} mark
 * @property {number} drawnMs
 */

class PreviewStrip extends HTMLElement {
  /** By preview index. @type {Map<number, Cell>} */
  #cells = new Map();
  /** By camera: its inputs. @type {Map<string, readonly string[]>} */
  #cameras = new Map();
  #camera = "";

  /** @param {Seat} seat */
  follow({ connection }) {
    connection.on("hello", ({ previews, cameras }) => this.#lay(previews ?? [], cameras));
    connection.on("preview", ({ preview, frame }) => this.#draw(preview, frame));
    connection.on("state", ({ camera }) => this.#mark(camera));
    connection.on("lost", () => this.#mark(this.#camera));
  }

  /** @param {readonly PreviewText[]} previews @param {readonly CameraText[]} cameras */
  #lay(previews, cameras) {
    this.#cameras = new Map(cameras.map((camera) => [camera.name, camera.inputs]));
    this.#cells.clear();
    this.replaceChildren(
      ...previews.map(({ index, input, width, height }) => {
        const canvas = make("canvas", { width: String(width), height: String(height) });
        canvas.setAttribute("role", "img");
        canvas.setAttribute("aria-label", `Camera input ${nameText(input)}`);
        const mark = make("span");
        const caption = make("figcaption", {}, make("span", {}, nameText(input)), mark);
        const silent = make("span", { class: "preview-silent" }, "no picture");
        const figure = make("figure", { "data-input": input }, canvas, silent, caption);
        const context = canvas.getContext("2d", { alpha: false });
        if (context === null) throw new Error("preview-strip: the browser draws no canvas");
        this.#cells.set(index, { input, figure, canvas, context, mark, drawnMs: -Infinity });
        return figure;
      }),
    );
    this.#mark(this.#camera);
  }

  /** @param {number} preview @param {VideoFrame} frame */
  #draw(preview, frame) {
    const cell = this.#cells.get(preview);
    if (cell === undefined) return;
    if (cell.canvas.width !== frame.displayWidth || cell.canvas.height !== frame.displayHeight) {
      cell.canvas.width = frame.displayWidth;
      cell.canvas.height = frame.displayHeight;
    }
    cell.context.drawImage(frame, 0, 0);
    cell.drawnMs = performance.now();
  }

  /** Mark the selected camera's inputs, and those that send nothing. @param {string | null} camera */
  #mark(camera) {
    this.#camera = camera ?? "";
    const inputs = this.#cameras.get(this.#camera) ?? [];
    for (const { input, figure, mark, drawnMs } of this.#cells.values()) {
      const selected = inputs.includes(input);
      const silent = performance.now() - drawnMs > SILENT_MS;
      setAttribute(figure, "data-selected", String(selected));
      setAttribute(figure, "data-silent", String(silent));
      setText(mark, selected ? "✓" : "");
      setAttribute(mark, "aria-label", selected ? "selected" : null);
    }
  }
}

customElements.define("preview-strip", PreviewStrip);

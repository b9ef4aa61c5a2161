/**
 * Pictures as I420: a plane of luma, then two of chroma with half its width and height.
 *
 * The matrix is that of ITU-R BT.601 with luma from 16 to 235, as the session's cameras have it.
 */

/** Splits NV12, whose chroma is one plane of pairs. @param {Uint8Array} nv12 @param {Uint8Array} i420 Of the same length. */
export function fromNv12(nv12, i420) {
  const luma = (i420.length * 2) / 3;
  const chroma = luma / 4;
  i420.set(nv12.subarray(0, luma));
  for (let index = 0; index < chroma; index += 1) {
    i420[luma + index] = /** @type {number} */ (nv12[luma + 2 * index]);
    i420[luma + chroma + index] = /** @type {number} */ (nv12[luma + 2 * index + 1]);
  }
}

/** @param {Uint8ClampedArray} rgba @param {number} width Even. @param {number} height Even. @param {Uint8Array} i420 */
export function fromRgba(rgba, width, height, i420) {
  const luma = width * height;
  const pixels = new Uint32Array(rgba.buffer, rgba.byteOffset, luma);
  let chroma = luma;
  for (let y = 0; y < height; y += 2) {
    for (let x = 0; x < width; x += 2) {
      const at = y * width + x;
      let red = 0;
      let green = 0;
      let blue = 0;
      for (const place of [at, at + 1, at + width, at + width + 1]) {
        const pixel = /** @type {number} */ (pixels[place]);
        const r = pixel & 0xff;
        const g = (pixel >> 8) & 0xff;
        const b = (pixel >> 16) & 0xff;
        i420[place] = 16 + ((66 * r + 129 * g + 25 * b + 128) >> 8);
        red += r;
        green += g;
        blue += b;
      }
      // Sums of four pixels: two bits more to shift.
      i420[chroma] = 128 + ((-38 * red - 74 * green + 112 * blue + 512) >> 10);
      i420[chroma + luma / 4] = 128 + ((112 * red - 94 * green - 18 * blue + 512) >> 10);
      chroma += 1;
    }
  }
}

/** Fills I420 of one size from frames of any size and format. */
export class FrameConverter {
  #width;
  #height;
  /** @type {OffscreenCanvasRenderingContext2D | null} */
  #context = null;
  #nv12;

  /** @param {number} width Even. @param {number} height Even. */
  constructor(width, height) {
    this.#width = width;
    this.#height = height;
    this.#nv12 = new Uint8Array((width * height * 3) / 2);
  }

  /** @param {VideoFrame} frame @param {Uint8Array<ArrayBuffer>} i420 */
  async fill(frame, i420) {
    const visible = frame.visibleRect;
    const fits = visible?.width === this.#width && visible.height === this.#height;
    if (fits && frame.format === "I420") {
      await frame.copyTo(i420);
    } else if (fits && frame.format === "NV12") {
      await frame.copyTo(this.#nv12);
      fromNv12(this.#nv12, i420);
    } else {
      fromRgba(this.#draw(frame), this.#width, this.#height, i420);
    }
  }

  /** Scales the frame so that it covers the picture; what stands out is cut off. @param {VideoFrame} frame */
  #draw(frame) {
    const [width, height] = [this.#width, this.#height];
    this.#context ??= new OffscreenCanvas(width, height).getContext("2d", {
      alpha: false,
      willReadFrequently: true,
    });
    const context = this.#context;
    if (context === null) throw new Error("no 2D canvas in a worker");
    const scale = Math.max(width / frame.displayWidth, height / frame.displayHeight);
    const [w, h] = [frame.displayWidth * scale, frame.displayHeight * scale];
    context.drawImage(frame, (width - w) / 2, (height - h) / 2, w, h);
    return context.getImageData(0, 0, width, height).data;
  }
}

/**
 * What a person sees in a headset, by WebGL: the picture on a plane whose middle is the origin of
 * the space, and on it its age and words. A frame around it is red while it is stale.
 */
import { make } from "./dom.js";

/** The picture's width in metres. */
const WIDE_M = 1.2;
/** The words' height, as a share of the picture's width, and of the canvas that has them. */
const WORDS_SHARE = 0.1;
const WORDS_PX = { width: 1280, height: 128 };
const FRAME_M = 0.02;
const RED = /** @type {const} */ ([0.77, 0.07, 0.11, 1]);
const GREY = /** @type {const} */ ([0.12, 0.14, 0.17, 1]);

const VERTEX = `
  attribute vec2 corner;
  uniform mat4 projection, view;
  uniform vec4 place, part;
  varying vec2 at;
  void main() {
    at = part.xy + vec2(corner.x, 1.0 - corner.y) * part.zw;
    gl_Position = projection * view * vec4(place.xy + corner * place.zw, 0.0, 1.0);
  }`;
const FRAGMENT = `
  precision mediump float;
  uniform sampler2D picture;
  uniform vec4 paint;
  varying vec2 at;
  void main() {
    gl_FragColor = paint.a > 0.0 ? paint : texture2D(picture, at);
  }`;

/** A part of a texture, as shares from its upper left corner: x, y, width, height. @typedef {readonly [number, number, number, number]} Part */

const WHOLE = /** @type {Part} */ ([0, 0, 1, 1]);
/** Of two whole pictures beside each other, each in half the width and half the height. @type {Record<string, Part>} */
const HALVES = { left: [0, 0.25, 0.5, 0.5], right: [0.5, 0.25, 0.5, 0.5] };

/** @typedef {{words: string, age: string, stale: boolean}} Said */

export class HeadsetView {
  gl;
  #words = make("canvas", { width: String(WORDS_PX.width), height: String(WORDS_PX.height) });
  /** @type {(name: string) => WebGLUniformLocation | null} */
  #uniform;
  #pictureTexture;
  #wordsTexture;
  #said = "";
  #drawn = -1;
  #aspect = 4 / 3;

  constructor() {
    // Its own size does not count: a session draws into a layer of its own.
    const gl = make("canvas").getContext("webgl", { xrCompatible: true, alpha: false, depth: false });
    if (gl === null) throw new Error("this browser draws nothing by WebGL");
    this.gl = gl;
    const program = gl.createProgram();
    for (const [kind, text] of /** @type {const} */ ([[gl.VERTEX_SHADER, VERTEX], [gl.FRAGMENT_SHADER, FRAGMENT]])) {
      const shader = gl.createShader(kind);
      if (shader === null) throw new Error("the graphics card was lost");
      gl.shaderSource(shader, text);
      gl.compileShader(shader);
      gl.attachShader(program, shader);
    }
    gl.linkProgram(program);
    gl.useProgram(program);
    this.#uniform = (name) => gl.getUniformLocation(program, name);
    const corners = new Float32Array([0, 0, 1, 0, 0, 1, 1, 1]);
    gl.bindBuffer(gl.ARRAY_BUFFER, gl.createBuffer());
    gl.bufferData(gl.ARRAY_BUFFER, corners, gl.STATIC_DRAW);
    const corner = gl.getAttribLocation(program, "corner");
    gl.enableVertexAttribArray(corner);
    gl.vertexAttribPointer(corner, 2, gl.FLOAT, false, 0, 0);
    this.#pictureTexture = this.#texture();
    this.#wordsTexture = this.#texture();
  }

  /** Takes a picture, if it is another one than the last. @param {HTMLCanvasElement} canvas @param {number} number */
  setPicture(canvas, number) {
    if (number === this.#drawn) return;
    this.#drawn = number;
    this.#aspect = canvas.width / canvas.height;
    this.#load(this.#pictureTexture, canvas);
  }

  /** @param {Said} said */
  setWords(said) {
    const key = JSON.stringify(said);
    const context = this.#words.getContext("2d");
    if (key === this.#said || context === null) return;
    this.#said = key;
    const { width, height } = WORDS_PX;
    context.fillStyle = said.stale ? "#c5121c" : "#14181d";
    context.fillRect(0, 0, width, height);
    context.fillStyle = "#ffffff";
    context.textBaseline = "middle";
    context.font = `700 ${height * 0.42}px system-ui, sans-serif`;
    context.fillText(said.age, 24, height * 0.28, width - 48);
    context.font = `${height * 0.32}px system-ui, sans-serif`;
    context.fillText(said.words, 24, height * 0.74, width - 48);
    this.#load(this.#wordsTexture, this.#words);
  }

  /**
   * Draws a frame. layer: of the session; pose: of the person in the picture's space.
   * @param {XRWebGLLayer} layer @param {XRViewerPose} pose @param {{stale: boolean, halves: boolean}} how
   */
  draw(layer, pose, { stale, halves }) {
    const { gl } = this;
    gl.bindFramebuffer(gl.FRAMEBUFFER, layer.framebuffer);
    gl.clearColor(0.03, 0.04, 0.05, 1);
    gl.clear(gl.COLOR_BUFFER_BIT);
    const high = WIDE_M / this.#aspect;
    const [x, y] = [-WIDE_M / 2, -high / 2];
    for (const view of pose.views) {
      const port = layer.getViewport(view);
      if (port === undefined) continue;
      gl.viewport(port.x, port.y, port.width, port.height);
      gl.uniformMatrix4fv(this.#uniform("projection"), false, view.projectionMatrix);
      gl.uniformMatrix4fv(this.#uniform("view"), false, view.transform.inverse.matrix);
      const part = (halves ? HALVES[view.eye] : undefined) ?? WHOLE;
      const edge = stale ? FRAME_M : FRAME_M / 4;
      this.#quad([x - edge, y - edge, WIDE_M + 2 * edge, high + 2 * edge], WHOLE, null, stale ? RED : GREY);
      this.#quad([x, y, WIDE_M, high], part, this.#pictureTexture);
      this.#quad([x, y + high + edge, WIDE_M, WIDE_M * WORDS_SHARE], WHOLE, this.#wordsTexture);
    }
  }

  /** @param {readonly number[]} place @param {Part} part @param {WebGLTexture | null} texture @param {readonly number[]} [paint] */
  #quad(place, part, texture, paint = [0, 0, 0, 0]) {
    const { gl } = this;
    gl.uniform4fv(this.#uniform("place"), place);
    gl.uniform4fv(this.#uniform("part"), part);
    gl.uniform4fv(this.#uniform("paint"), paint);
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.drawArrays(gl.TRIANGLE_STRIP, 0, 4);
  }

  #texture() {
    const { gl } = this;
    const texture = gl.createTexture();
    gl.bindTexture(gl.TEXTURE_2D, texture);
    // Sizes of pictures are no powers of two.
    for (const side of [gl.TEXTURE_WRAP_S, gl.TEXTURE_WRAP_T]) gl.texParameteri(gl.TEXTURE_2D, side, gl.CLAMP_TO_EDGE);
    gl.texParameteri(gl.TEXTURE_2D, gl.TEXTURE_MIN_FILTER, gl.LINEAR);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, 1, 1, 0, gl.RGBA, gl.UNSIGNED_BYTE, new Uint8Array(4));
    return texture;
  }

  /** @param {WebGLTexture} texture @param {HTMLCanvasElement} canvas */
  #load(texture, canvas) {
    const { gl } = this;
    gl.bindTexture(gl.TEXTURE_2D, texture);
    gl.texImage2D(gl.TEXTURE_2D, 0, gl.RGBA, gl.RGBA, gl.UNSIGNED_BYTE, canvas);
  }
}

/**
 * The types of what a page and its capture worker tell each other.
 *
 * @import { InputText } from "./texts.js"
 */

/**
 * What the worker is to send: pictures from a stream of frames, or blocks of sound from a port.
 * @typedef {{kind: "pictures", input: InputText, frames: ReadableStream<VideoFrame>}
 *   | {kind: "sound", input: InputText, port: MessagePort}} CaptureOrder
 */

/**
 * taken: the input is this page's now. refused: it is not, and the worker stopped.
 * lost: the server is not heard; the worker tries again.
 * @typedef {{kind: "taken"} | {kind: "refused", why: string} | {kind: "lost"}} CaptureNote
 */

export {};

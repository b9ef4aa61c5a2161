/**
 * The types of what a page and its seat worker tell each other.
 *
 * @import { Hand } from "./wire.js"
 * @import { ServerText } from "./texts.js"
 */

/**
 * A picture to draw. The page closes its frame and then says that it was drawn.
 * @typedef {object} FrameNote
 * @property {"frame"} kind
 * @property {number} stream
 * @property {VideoFrame} frame
 * @property {number} sequence
 * @property {number | null} captureUs
 * @property {boolean} damaged
 * @property {number} receivedMs When its access unit's picture left the decoder; page clock.
 */

/**
 * @typedef {object} PreviewNote
 * @property {"preview"} kind
 * @property {number} preview
 * @property {VideoFrame} frame
 * @property {number | null} captureUs
 */

/** @typedef {{kind: "haptic", message: ArrayBuffer}} HapticNote As it came: see `readHaptics`. */

/** @typedef {{kind: "text", text: ServerText}} TextNote */
/** @typedef {{kind: "clock", offsetUs: number, roundTripMs: number}} ClockNote */
/** @typedef {{kind: "heard"}} HeardNote The server is heard again. */
/** @typedef {{kind: "lost", why: "closed" | "silent" | "refused", reason: string}} LostNote */
/** @typedef {{kind: "fault", stream: number, why: string}} FaultNote A decoder closed. */
/** @typedef {{kind: "let_go"}} LetGoNote The hand was released because the page was silent. */

/**
 * @typedef {TextNote | FrameNote | PreviewNote | HapticNote | ClockNote | HeardNote | LostNote
 *   | FaultNote | LetGoNote} WorkerNote
 */

/**
 * @typedef {{kind: "request", text: string}
 *   | {kind: "drawn", stream: number}
 *   | {kind: "sound_port", stream: string, port: MessagePort}
 *   | {kind: "hand", hand: Hand, pictureUs: number}} PageNote
 */

export {};

/** The types of what the worklets are told of sound, and of what they tell. */

/**
 * A block of a voice, sent to the port that the page attached for the stream.
 * @typedef {object} SoundNote
 * @property {Int16Array<ArrayBuffer>} samples
 * @property {number | null} captureUs
 * @property {boolean} concealed
 */

/**
 * What a voice's player says ten times a second.
 * @typedef {object} PlayingNote
 * @property {number} peak The largest sample since the last note, 0 to 1.
 * @property {number} stockMs
 * @property {number | null} captureUs
 * @property {number} dropped Samples.
 * @property {number} dry
 */

/**
 * A block of the page's own microphone.
 * @typedef {object} BlockNote
 * @property {Int16Array<ArrayBuffer>} samples
 * @property {number} firstMs When its first sample was captured, on the AudioContext's clock.
 */

/** @typedef {{peak: number}} MicrophoneNote The largest sample since the last note, 0 to 1. */

export {};

/**
 * The binary messages between a seat's page and its server, all little-endian.
 *
 * The first octet is the type. Instants ending in `Us` are of the session's monotonic clock,
 * those ending in `PageMs` are `performance.timeOrigin + performance.now()`.
 */

export const Kind = Object.freeze({
  UNIT: 1,
  SOUND: 2,
  HAPTIC: 3,
  PREVIEW: 4,
  PONG: 5,
  PING: 0x81,
  HAND: 0x82,
  OWN_PICTURE: 0x83,
  OWN_SOUND: 0x84,
});

const HEADER_OCTETS = 16;
const HAPTIC_HEADER_OCTETS = 8;
/** Of a row beside its columns: instant and flags. */
const HAPTIC_ROW_OCTETS = 12;
const HAND_OCTETS = 24;
/** Samples in a block of the page's own sound: 20 ms at 48 kHz. */
export const BLOCK_SAMPLES = 960;

/**
 * An access unit of a stream.
 * @typedef {object} Unit
 * @property {number} stream
 * @property {boolean} key
 * @property {boolean} damaged
 * @property {boolean} replayed It is to be decoded, but not drawn.
 * @property {number} sequence
 * @property {number | null} captureUs
 * @property {Uint8Array<ArrayBuffer>} data Annex B.
 */

/**
 * A block of a voice: mono, 48 kHz.
 * @typedef {object} Sound
 * @property {number} stream
 * @property {boolean} concealed
 * @property {number} sequence
 * @property {number | null} captureUs
 * @property {Int16Array<ArrayBuffer>} samples
 */

/**
 * Cycles of one end of haptics, a column for each quantity.
 *
 * @typedef {object} Haptics
 * @property {"joystick" | "robot"} end
 * @property {number} rows
 * @property {Float64Array} timeUs
 * @property {Float32Array} xM
 * @property {Float32Array} yM
 * @property {Float32Array} forceXN
 * @property {Float32Array} forceYN
 * @property {Float32Array} energyUj
 * @property {Float32Array[]} columns All of these, and behind them those of more fields and axes.
 * @property {Uint32Array} flags See `HapticFlag`, `stateNumber` and `litLed`.
 */

export const HapticFlag = Object.freeze({ CONTACT: 1, DEAD_MAN: 2, ACTED: 4 });

/** The number of the joystick's state in a row's flags. @param {number} flags */
export const stateNumber = (flags) => (flags >> 8) & 0xf;

/** The index of the lit LED in a row's flags, or null. @param {number} flags */
export function litLed(flags) {
  const number = (flags >> 16) & 0xff;
  return number === 0 ? null : number - 1;
}

/**
 * A small picture of an input.
 * @typedef {object} Preview
 * @property {number} preview
 * @property {number} width
 * @property {number} height
 * @property {number | null} captureUs
 * @property {Uint8Array<ArrayBuffer>} i420
 */

/** @param {ArrayBuffer} message */
export const kindOf = (message) => new DataView(message).getUint8(0);

/** @param {DataView} view @param {number} offset */
function instantUs(view, offset) {
  const us = Number(view.getBigInt64(offset, true));
  return us < 0 ? null : us;
}

/** @param {ArrayBuffer} message @returns {Unit} */
export function readUnit(message) {
  const view = new DataView(message);
  const flags = view.getUint8(2);
  return {
    stream: view.getUint8(1),
    key: (flags & 1) !== 0,
    damaged: (flags & 2) !== 0,
    replayed: (flags & 4) !== 0,
    sequence: view.getUint32(4, true),
    captureUs: instantUs(view, 8),
    data: new Uint8Array(message, HEADER_OCTETS),
  };
}

/** @param {ArrayBuffer} message @returns {Sound} */
export function readSound(message) {
  const view = new DataView(message);
  return {
    stream: view.getUint8(1),
    concealed: (view.getUint8(2) & 1) !== 0,
    sequence: view.getUint32(4, true),
    captureUs: instantUs(view, 8),
    samples: new Int16Array(message, HEADER_OCTETS),
  };
}

/** @param {ArrayBuffer} message @returns {Haptics} */
export function readHaptics(message) {
  const view = new DataView(message);
  const rows = view.getUint16(2, true);
  const octets = rows === 0 ? 0 : (message.byteLength - HAPTIC_HEADER_OCTETS) / rows;
  const count = Math.max(5, (octets - HAPTIC_ROW_OCTETS) / 4);
  const columns = Array.from({ length: count }, () => new Float32Array(rows));
  const timeUs = new Float64Array(rows);
  const flags = new Uint32Array(rows);
  for (let row = 0; row < rows; row += 1) {
    const at = HAPTIC_HEADER_OCTETS + row * octets;
    timeUs[row] = view.getFloat64(at, true);
    columns.forEach((column, index) => {
      column[row] = view.getFloat32(at + 8 + 4 * index, true);
    });
    flags[row] = view.getUint32(at + octets - 4, true);
  }
  const [xM, yM, forceXN, forceYN, energyUj] = /** @type {[Float32Array, Float32Array, Float32Array, Float32Array, Float32Array]} */ (
    columns
  );
  const end = view.getUint8(1) === 0 ? "joystick" : "robot";
  return { end, rows, timeUs, xM, yM, forceXN, forceYN, energyUj, columns, flags };
}

/** @param {ArrayBuffer} message @returns {Preview} */
export function readPreview(message) {
  const view = new DataView(message);
  return {
    preview: view.getUint8(1),
    width: view.getUint16(2, true),
    height: view.getUint16(4, true),
    captureUs: instantUs(view, 8),
    i420: new Uint8Array(message, HEADER_OCTETS),
  };
}

/** @param {ArrayBuffer} message @returns {{pageMs: number, nowUs: number}} */
export function readPong(message) {
  const view = new DataView(message);
  return { pageMs: view.getFloat64(8, true), nowUs: Number(view.getBigInt64(16, true)) };
}

/** @param {number} pageMs */
export function writePing(pageMs) {
  const message = new ArrayBuffer(16);
  const view = new DataView(message);
  view.setUint8(0, Kind.PING);
  view.setFloat64(8, pageMs, true);
  return message;
}

/**
 * What the hand does. x, y: -1 to 1 of the half workspace, y up.
 * @typedef {object} Hand
 * @property {boolean} deadMan
 * @property {number} x
 * @property {number} y
 * @property {number} buttons One bit a button.
 * @property {number[]} [more] Wanted places of the axes behind x and y, -1 to 1.
 */

/**
 * @param {Hand} hand @param {number} sequence
 * @param {number} pictureUs When the picture was captured that is painted, on the session's clock;
 *   0 if none is yet, -1 if the page shows none.
 */
export function writeHand(hand, sequence, pictureUs) {
  const more = hand.more ?? [];
  const message = new ArrayBuffer(HAND_OCTETS + 4 * more.length);
  const view = new DataView(message);
  more.forEach((share, axis) => view.setFloat32(HAND_OCTETS + 4 * axis, share, true));
  view.setUint8(0, Kind.HAND);
  view.setUint8(1, hand.deadMan ? 1 : 0);
  view.setUint16(2, hand.buttons, true);
  view.setUint32(4, sequence >>> 0, true);
  view.setFloat32(8, hand.x, true);
  view.setFloat32(12, hand.y, true);
  view.setFloat64(16, pictureUs, true);
  return message;
}

/**
 * A message with room for one I420 picture, and the view to fill it through.
 * @param {number} input @param {number} width @param {number} height @param {number} pageMs
 */
export function ownPicture(input, width, height, pageMs) {
  const message = new ArrayBuffer(HEADER_OCTETS + (width * height * 3) / 2);
  const view = new DataView(message);
  view.setUint8(0, Kind.OWN_PICTURE);
  view.setUint8(1, input);
  view.setUint16(2, width, true);
  view.setUint16(4, height, true);
  view.setFloat64(8, pageMs, true);
  return { message, i420: new Uint8Array(message, HEADER_OCTETS) };
}

/**
 * @param {number} input @param {number} sequence @param {number} pageMs Of the first sample.
 * @param {Int16Array} samples `BLOCK_SAMPLES` of them.
 */
export function writeOwnSound(input, sequence, pageMs, samples) {
  const message = new ArrayBuffer(HEADER_OCTETS + 2 * BLOCK_SAMPLES);
  const view = new DataView(message);
  view.setUint8(0, Kind.OWN_SOUND);
  view.setUint8(1, input);
  view.setUint16(2, BLOCK_SAMPLES, true);
  view.setUint32(4, sequence >>> 0, true);
  view.setFloat64(8, pageMs, true);
  new Int16Array(message, HEADER_OCTETS).set(samples);
  return message;
}

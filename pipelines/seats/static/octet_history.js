/** Rates of one direction of the link by what its octets carried, over the last minutes. */

/**
 * What is drawn as one layer, from the bottom of the stack to its top: its name, its colour's
 * token, and the names in the report that it sums.
 * @type {readonly {name: string, colour: string, parts: readonly string[]}[]}
 */
export const LAYERS = [
  { name: "hand", colour: "--layer-hand", parts: ["haptic"] },
  { name: "voice", colour: "--layer-voice", parts: ["voice"] },
  { name: "pictures", colour: "--layer-pictures", parts: ["video"] },
  { name: "TM/TC", colour: "--layer-commands", parts: ["tmtc"] },
  { name: "maintenance", colour: "--layer-maintenance", parts: ["maintenance"] },
  { name: "RTCP, supervision", colour: "--layer-control", parts: ["rtcp", "supervision"] },
  { name: "headers, framing", colour: "--layer-headers", parts: ["header", "fecf", "packet_headers", "framing"] },
];

/** In no layer: what fills the frames, and is larger than all else. */
const IDLE = ["idle", "repair"];
/** A longer step between two readings is a gap: nobody asked for figures meanwhile. */
const GAP_US = 3_200_000;

export class OctetHistory {
  /**
   * @param {number} columns readings that are kept
   */
  constructor(columns) {
    this.columns = columns;
    /** Readings ever made; reading n lies at n modulo `columns`. */
    this.appended = 0;
    /** bit/s by reading and layer; NaN in a gap. */
    this.ratesBps = new Float32Array(columns * LAYERS.length);
    this.idleBps = NaN;
    /** @type {Map<string, number>} */
    this.last = new Map();
    this.lastUs = NaN;
    /** @type {Map<string, number>} */
    this.layerOf = new Map();
    LAYERS.forEach((layer, index) => {
      for (const part of layer.parts) this.layerOf.set(part, index);
    });
  }

  /** Take a reading of the counts; the first one only begins.
   * @param {number} atUs
   * @param {Readonly<Record<string, number>>} octets by what they carried, counted since the start
   */
  append(atUs, octets) {
    const stepUs = atUs - this.lastUs;
    if (stepUs <= 0) return;
    if (stepUs > GAP_US) this.#gap();
    else if (stepUs > 0) this.#rates(stepUs, octets);
    this.lastUs = atUs;
    for (const [carried, count] of Object.entries(octets)) this.last.set(carried, count);
  }

  /** The rate of a layer in a reading, bit/s; NaN in a gap or out of range.
   * @param {number} reading
   * @param {number} layer
   */
  rate(reading, layer) {
    if (reading < 0 || reading >= this.appended || reading < this.appended - this.columns) return NaN;
    return this.ratesBps[(reading % this.columns) * LAYERS.length + layer];
  }

  /** The sum of all layers in a reading, bit/s; NaN in a gap.
   * @param {number} reading
   */
  total(reading) {
    let sum = 0;
    for (let layer = 0; layer < LAYERS.length; layer++) sum += this.rate(reading, layer);
    return sum;
  }

  #gap() {
    const at = (this.appended % this.columns) * LAYERS.length;
    this.ratesBps.fill(NaN, at, at + LAYERS.length);
    this.idleBps = NaN;
    this.appended++;
  }

  /**
   * @param {number} stepUs
   * @param {Readonly<Record<string, number>>} octets
   */
  #rates(stepUs, octets) {
    const at = (this.appended % this.columns) * LAYERS.length;
    this.ratesBps.fill(0, at, at + LAYERS.length);
    this.idleBps = 0;
    for (const [carried, count] of Object.entries(octets)) {
      const more = count - (this.last.get(carried) ?? count);
      if (more < 0) return this.#gap();
      const bps = (more * 8e6) / stepUs;
      if (IDLE.includes(carried)) {
        this.idleBps += bps;
        continue;
      }
      this.ratesBps[at + (this.layerOf.get(carried) ?? LAYERS.length - 1)] += bps;
    }
    this.appended++;
  }
}

/** What of an H.264 byte stream (ITU-T H.264, Annex B) a browser's decoder must be told. */

const SPS = 7;

/**
 * The codec string `avc1.PPCCLL` (RFC 6381, 3.3) of the first SPS in an access unit, or null.
 * @param {Uint8Array} unit
 */
export function codecOf(unit) {
  for (let at = 0; at + 6 < unit.length; at += 1) {
    if (unit[at] !== 0 || unit[at + 1] !== 0 || unit[at + 2] !== 1) continue;
    if ((/** @type {number} */ (unit[at + 3]) & 0x1f) !== SPS) continue;
    const profile = unit.subarray(at + 4, at + 7);
    return `avc1.${Array.from(profile, (octet) => octet.toString(16).padStart(2, "0")).join("")}`;
  }
  return null;
}

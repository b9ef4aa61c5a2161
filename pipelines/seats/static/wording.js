/** Figures as people read them: short, with their unit, and "–" where there is none. */
import { NOTHING } from "./figure_binding.js";

/** @param {unknown} value @returns {value is number} */
function known(value) {
  return typeof value === "number" && Number.isFinite(value);
}

/** A number with about three digits.
 * @param {number} value
 */
function digits(value) {
  const size = Math.abs(value);
  return value.toFixed(size >= 99.95 || size === 0 ? 0 : size >= 9.995 ? 1 : 2);
}

/** A rate.
 * @param {unknown} bps
 */
export function rateText(bps) {
  if (!known(bps)) return NOTHING;
  return Math.abs(bps) >= 999_500 ? `${digits(bps / 1e6)} Mbit/s` : `${digits(bps / 1e3)} kbit/s`;
}

/** A duration in milliseconds; seconds from 10 s on.
 * @param {unknown} ms
 */
export function millisecondsText(ms) {
  if (!known(ms)) return NOTHING;
  return Math.abs(ms) >= 10_000 ? `${digits(ms / 1e3)} s` : `${digits(ms)} ms`;
}

/** Minutes and seconds.
 * @param {unknown} seconds
 */
export function clockText(seconds) {
  if (!known(seconds)) return NOTHING;
  const whole = Math.floor(Math.abs(seconds));
  const [hours, minutes] = [Math.floor(whole / 3600), Math.floor(whole / 60) % 60];
  const two = (/** @type {number} */ n) => String(n).padStart(2, "0");
  const text = `${two(minutes)}:${two(whole % 60)}`;
  return (seconds < 0 ? "−" : "") + (hours > 0 ? `${hours}:${text}` : text);
}

/** An age: tenths of seconds below ten seconds, then seconds, minutes, hours.
 * @param {unknown} seconds
 */
export function agoText(seconds) {
  if (!known(seconds)) return NOTHING;
  if (seconds < 9.95) return `${seconds.toFixed(1)} s`;
  if (seconds < 99.5) return `${seconds.toFixed(0)} s`;
  return clockText(seconds);
}

/** A count with thin spaces between thousands.
 * @param {unknown} value
 */
export function countText(value) {
  if (!known(value)) return NOTHING;
  return String(Math.round(value)).replace(/\B(?=(\d{3})+$)/g, "\u2009");
}

/** How far to go and whereto; "" if no further. @param {number} xM To the right. @param {number} yM Up. */
export function wayText(xM, yM) {
  /** @param {number} m @param {string} onwards @param {string} back */
  const along = (m, onwards, back) => {
    const mm = Math.round(1000 * Math.abs(m));
    return mm === 0 ? "" : `${mm} mm ${m > 0 ? onwards : back}`;
  };
  return [along(xM, "right", "left"), along(yM, "up", "down")].filter(Boolean).join(", ");
}

/** A name of the report in words: `uplink_video` is "uplink video".
 * @param {string} name
 */
export function nameText(name) {
  return name.replaceAll("_", " ").replace(/([a-z])([A-Z])/g, (_, end, begin) => `${end} ${begin.toLowerCase()}`);
}

/**
 * The radio link in a few words, above its state.
 *
 * `open`: the two machines talk without protection. That stays in sight as long as it is so.
 * @param {{ connected: boolean, signal: boolean, open: boolean }} link
 */
export function linkText({ connected, signal, open }) {
  const name = open ? "Link NOT PROTECTED" : "Radio link";
  return connected ? name : `${name}: ${signal ? "signal" : "no signal"}`;
}

/** Why an end of the link sends nothing, or refuses the other one; "" if nothing is in the way.
 * @param {import("./figure_binding.js").FigureBinding} figures
 */
export function linkObstacle(figures) {
  const found = ["space", "ground"].flatMap((end) => {
    const state = figures.get(`gateways.${end}.supervision.state`);
    const why = figures.get(`gateways.${end}.supervision.why`);
    return state === "check" || state === "refused" ? [`${end}: ${String(why ?? "")}`] : [];
  });
  return found.length === 0 ? "" : `No link: ${found.join("; ")}`;
}

/** Seconds since the link of an end is connected; null while it is not, or is not known.
 * @param {import("./figure_binding.js").FigureBinding} figures
 * @param {string} end
 * @param {number | null} nowUs of the session
 */
export function connectedS(figures, end, nowUs) {
  const head = `gateways.${end}.supervision`;
  const [begunNs, sinceNs] = [figures.number(`${head}.begun_ns`), figures.number(`${head}.since_ns`)];
  if (figures.get(`${head}.state`) !== "connected" || begunNs === null || sinceNs === null || nowUs === null) return null;
  return Math.max(0, nowUs / 1e6 - (begunNs + sinceNs) / 1e9);
}

/** What the radio does now, by the ends known here and by its pass; null without either.
 * @param {import("./figure_binding.js").FigureBinding} figures
 * @returns {{text: string, level: "good" | "warn" | "bad"} | null}
 */
export function radioSays(figures) {
  const ways = [["up", "space"], ["down", "ground"]].flatMap(([way, end]) => {
    const signal = figures.get(`gateways.${end}.supervision.signal`);
    return typeof signal === "boolean" ? [{ way, signal }] : [];
  });
  if (ways.length === 0) return null;
  const [sinceS, untilS] = [figures.number("contact.since_acquisition_s"), figures.number("contact.until_loss_s")];
  if (sinceS !== null && sinceS < 0) return { text: `no pass yet: signal in ${clockText(-sinceS)}`, level: "warn" };
  if (untilS !== null && untilS < 0) return { text: `pass over since ${clockText(-untilS)}`, level: "bad" };
  const dead = ways.filter(({ signal }) => !signal).map(({ way }) => way);
  if (dead.length === ways.length) return { text: "no signal", level: "bad" };
  if (dead.length > 0) return { text: `nothing goes ${dead.join("")}`, level: "bad" };
  const lost = untilS === null ? "" : `, lost in ${clockText(untilS)}`;
  return { text: `carries ${ways.map(({ way }) => way).join(" and ")}${lost}`, level: "good" };
}

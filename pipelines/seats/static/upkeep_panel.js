/**
 * `<upkeep-panel>`: what a systems operator must know before anything is updated: whether an
 * experiment runs, what the pass brings next, bandwidth, and whether the two ends fit together.
 *
 * @import { FigureBinding } from "./figure_binding.js"
 * @import { Seat } from "./seat.js"
 * @import { Level } from "./texts.js"
 */
import { make, setAttribute, setText } from "./dom.js";
import { clockText, nameText } from "./wording.js";

/** What comes within this many seconds is marked. */
const SOON_S = 60;
/** An update that begins later than this before a loss of signal is cut. Chosen. */
const UPDATE_S = 120;

/** @typedef {[string, Level]} Said */

/** By name of a row. @type {[string, (figures: FigureBinding) => Said][]} */
const ROWS = [
  ["Experiment", experimentSays],
  ["Next", contactSays],
  ["Bandwidth", bandwidthSays],
  ["Versions, ground", (figures) => endsSay(figures, "ground")],
  ["Versions, space", (figures) => endsSay(figures, "space")],
];

class UpkeepPanel extends HTMLElement {
  /** @param {Seat} seat */
  follow({ connection, figures }) {
    const list = make("dl", { class: "values" });
    const rows = ROWS.map(([name, says]) => {
      const value = make("dd", {}, "–");
      list.append(make("dt", {}, name), value);
      return { says, value };
    });
    this.append(make("header", {}, make("h2", {}, "Before an update")), list);
    const show = () => {
      for (const { says, value } of rows) {
        const [text, level] = connection.alive ? says(figures) : ["–", "none"];
        setText(value, text);
        setAttribute(value, "data-level", level);
      }
    };
    connection.on("figures", show);
    connection.on("lost", show);
  }
}

/** @param {FigureBinding} figures @returns {Said} */
function experimentSays(figures) {
  const runs = figures.get("upkeep.experiment");
  if (runs !== null) return [`${nameText(String(runs))}: updates wait`, "warn"];
  const [what, leftS] = [figures.get("contact.ahead"), figures.number("contact.ahead_s")];
  if (what === "loss of signal" && leftS !== null && leftS <= UPDATE_S) {
    return [`none runs, but the signal is lost in ${clockText(leftS)}: no update now`, "warn"];
  }
  const states = ["space", "ground"].map((end) => figures.get(`gateways.${end}.supervision.state`));
  const there = states.filter((state) => state !== null);
  if (there.length > 0 && !there.includes("connected")) return ["none runs, and there is no contact", "warn"];
  return ["none runs: updates may go", "good"];
}

/** @param {FigureBinding} figures @returns {Said} */
function contactSays(figures) {
  const [what, leftS] = [figures.get("contact.ahead"), figures.number("contact.ahead_s")];
  if (what === null || leftS === null) return ["nothing is planned", "none"];
  return [`${String(what)} in ${clockText(leftS)}`, leftS <= SOON_S ? "warn" : "none"];
}

/** @param {FigureBinding} figures @returns {Said} */
function bandwidthSays(figures) {
  const short = figures.get("upkeep.short");
  return short === null ? ["enough for all media", "good"] : [`short: ${String(short)}`, "bad"];
}

/** @param {FigureBinding} figures @param {string} end @returns {Said} */
function endsSay(figures, end) {
  const state = figures.get(`gateways.${end}.supervision.state`);
  const why = String(figures.get(`gateways.${end}.supervision.why`) ?? "");
  if (state === "connected") return ["fit together", "good"];
  if (state === "refused") return [`do not fit: ${why}`, "bad"];
  return [state === null ? "not known here" : `not known yet: ${why || String(state)}`, "none"];
}

customElements.define("upkeep-panel", UpkeepPanel);

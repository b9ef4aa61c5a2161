/**
 * What the path to the other machine carries, and what goes over it, as a list. It is hidden where
 * both ends are on one machine.
 *
 * @import { FigureBinding } from "./figure_binding.js"
 * @import { Seat } from "./seat.js"
 */
import { make, setAttribute, setText } from "./dom.js";
import { NOTHING } from "./figure_binding.js";
import { millisecondsText, rateText } from "./wording.js";

/** By end: the other one. */
const PEERS = { ground: "space", space: "ground" };
const ROWS = ["Path carries", "Path loses", "Video at most", "Waits for order"];

/** @param {Seat} seat */
export function pathList({ connection, figures }) {
  const [name, state, why] = [make("dt"), make("dd"), make("dd", { class: "why" })];
  const values = ROWS.map(() => make("dd"));
  const rows = ROWS.flatMap((row, index) => [make("dt", {}, row), values[index]]);
  const list = make("dl", { class: "values path", hidden: true }, name, state, why, ...rows);
  connection.on("figures", () => {
    const said = pathSays(figures);
    list.hidden = said === null;
    if (said === null) return;
    setText(name, `Path to ${said.peer}`);
    setText(state, said.state);
    setAttribute(state, "data-level", said.why === "" ? "none" : "warn");
    setText(why, said.why);
    values.forEach((value, row) => setText(value, said.texts[row]));
  });
  return list;
}

/** The path in words, with a text for each row; null without one. @param {FigureBinding} figures */
export function pathSays(figures) {
  for (const [end, peer] of Object.entries(PEERS)) {
    const of = (/** @type {string} */ name) => figures.get(`gateways.${end}.peer.${name}`);
    const state = of("path_state");
    if (state === null) continue;
    // Nothing is measured without protection, and by an older version.
    const measured = Number(of("path_bps")) > 0;
    const loss = `${(100 * Number(of("path_loss"))).toFixed(1)} %`;
    const waits = millisecondsText(Number(of("order_budget_ns")) / 1e6);
    const texts = [rateText(of("path_bps")), loss, rateText(of("video_cap_bps")), waits];
    return {
      peer,
      state: measured ? String(state) : "not measured",
      why: String(of("path_why") ?? ""),
      texts: texts.map((text) => (measured ? text : NOTHING)),
    };
  }
  return null;
}

/**
 * `<transfer-table>`: the files on their way that were asked for at the ends of this machine.
 *
 * @import { Seat } from "./seat.js"
 * @import { TransferText } from "./texts.js"
 */
import { make } from "./dom.js";
import { countText, rateText } from "./wording.js";

class TransferTable extends HTMLElement {
  /** @param {Seat} seat */
  follow({ connection }) {
    const none = make("p", { class: "small quiet" });
    const list = make("ul", { class: "transfers" });
    this.append(make("header", {}, make("h2", {}, "Files in transfer")), none, list);
    connection.on("upkeep", ({ files, transfers }) => {
      none.hidden = transfers.length > 0;
      none.textContent = files ? "None is under way." : "This session carries no files: give it --files.";
      list.replaceChildren(...transfers.map(transferRow));
    });
  }
}

/** @param {TransferText} transfer */
function transferRow({ end, number, what, state, octets, size, rate_bps: rateBps, name }) {
  const words = size === null ? `${countText(octets)} bytes` : `${Math.floor((100 * octets) / Math.max(1, size))} % of ${countText(size)} bytes`;
  const rate = state === "running" ? `, ${rateText(rateBps)}` : "";
  const bar = make("progress", { max: String(Math.max(1, size ?? 1)), value: String(size === null ? 0 : octets), "aria-label": `Progress of ${name}` });
  return make(
    "li",
    { "data-state": state },
    make("span", { class: "transfer-name" }, `${what} ${name}`),
    make("span", { class: "quiet" }, `${end} ${number}`),
    bar,
    make("span", { class: "transfer-state", "data-level": state === "running" ? "good" : "warn" }, `${state}: ${words}${rate}`),
  );
}

customElements.define("transfer-table", TransferTable);

/**
 * `<relay-table>`: what each end passed on of telecommands, telemetry and K2ACI.
 *
 * @import { Seat } from "./seat.js"
 */
import { make } from "./dom.js";
import { nameText } from "./wording.js";

const ENDS = ["space", "ground"];
/** Name and figure of each row. @type {[string, string][]} */
const ROWS = [
  ["packets sent", "pus_sent"],
  ["bytes sent", "pus_sent_octets"],
  ["packets received", "pus_received"],
  ["garbage", "pus_garbage"],
  ["delayed for the pictures' share", "pus_delayed"],
  ["dropped", "pus_dropped"],
  ["telecommands sent", "pus_telecommands"],
  ["telecommands repeated", "pus_telecommands_repeated"],
  ["telecommands carried out", "pus_executed"],
  ["telecommands failed", "pus_failed"],
  ["telecommands that came twice", "pus_duplicates"],
  ["events reported", "pus_events"],
  ["housekeeping sent", "pus_housekeeping"],
  ["reports received", "pus_reports"],
  ["K2ACI sent", "k2aci_sent"],
  ["K2ACI repeated", "k2aci_repeated"],
  ["K2ACI received", "k2aci_arrived"],
];

class RelayTable extends HTMLElement {
  /** @param {Seat} seat */
  follow({ figures }) {
    const head = make("tr", {}, make("td"), ...ENDS.map((end) => make("th", { scope: "col" }, nameText(end))));
    const rows = ROWS.map(([name, figure]) =>
      make(
        "tr",
        {},
        make("th", { scope: "row" }, name),
        ...ENDS.map((end) => make("td", { class: "number", "data-figure": `tmtc.${end}.${figure}` }, "–")),
      ),
    );
    this.append(make("table", {}, make("thead", {}, head), make("tbody", {}, ...rows)));
    figures.refresh();
  }
}

customElements.define("relay-table", RelayTable);

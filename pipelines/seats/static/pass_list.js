/**
 * `<pass-list>`: the passes ahead: when the signal is acquired and lost, and how high each gets.
 *
 * @import { Seat } from "./seat.js"
 * @import { PassText } from "./texts.js"
 */
import { make, setText } from "./dom.js";
import { clockText } from "./wording.js";

class PassList extends HTMLElement {
  /** @param {Seat} seat */
  follow({ connection, figures }) {
    const none = make("p", { class: "small quiet" }, "The radio of this session has no orbit: contact does not end.");
    const body = make("tbody");
    const head = make("tr", {}, ...["acquisition (UTC)", "in", "lasts", "highest"].map((word) => make("th", { scope: "col" }, word)));
    const table = make("table", { class: "passes", hidden: true }, make("thead", {}, head), body);
    this.append(make("header", {}, make("h2", {}, "Contacts ahead")), none, table);
    /** @type {{pass: PassText, cell: HTMLElement, row: HTMLElement}[]} */
    let rows = [];
    connection.on("hello", ({ passes }) => {
      none.hidden = passes.length > 0;
      table.hidden = passes.length === 0;
      rows = passes.map((pass) => {
        const cell = make("td", { class: "number" });
        const row = make(
          "tr",
          {},
          make("th", { scope: "row" }, pass.acquisition.replace("T", " ").replace("Z", "")),
          cell,
          make("td", { class: "number" }, clockText(pass.loss_s - pass.acquisition_s)),
          make("td", { class: "number" }, `${pass.peak_deg.toFixed(0)}°`),
        );
        return { pass, cell, row };
      });
      body.replaceChildren(...rows.map(({ row }) => row));
    });
    connection.on("figures", () => {
      const sinceS = figures.number("contact.since_acquisition_s");
      if (sinceS === null) return;
      for (const { pass, cell, row } of rows) {
        const untilS = pass.acquisition_s - sinceS;
        const now = untilS <= 0 && pass.loss_s > sinceS;
        setText(cell, now ? "now" : untilS > 0 ? clockText(untilS) : "over");
        row.dataset.now = String(now);
      }
    });
  }
}

customElements.define("pass-list", PassList);

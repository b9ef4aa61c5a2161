/**
 * `<link-table>`: what waits at each level of both directions and for how long, and what the link
 * lost. It asks for figures by `data-figure-in`, so refresh the binding after it was connected.
 *
 * @import { LinkCounts } from "./texts.js"
 */
import { make, setAttribute, setText } from "./make.js";
import { count } from "./wording.js";

const DIRECTIONS = ["uplink", "downlink"];
/** The levels of the link's sender that have a queue, by falling priority. */
const LEVELS = [
  { level: "tmtc", name: "telecommands, telemetry" },
  { level: "voice", name: "voice" },
  { level: "video", name: "pictures" },
  { level: "maintenance", name: "maintenance" },
];

/** @param {string} name @param {string} scale @param {string} decimals */
const figure = (name, scale, decimals) =>
  make("td", { class: "number", "data-figure-in": name, "data-scale": scale, "data-decimals": decimals });

export class LinkTable extends HTMLElement {
  /** By direction: the cells of drops, losses and slips. @type {Map<string, HTMLElement[]>} */
  #counts = new Map();

  connectedCallback() {
    if (this.childElementCount > 0) return;
    const head = make("tr", {}, make("td"));
    const units = make("tr", { class: "units" }, make("th", { scope: "col" }, "queue"));
    for (const direction of DIRECTIONS) {
      head.append(make("th", { scope: "colgroup", colspan: "2" }, direction));
      units.append(make("th", { scope: "col" }, "oldest, ms"), make("th", { scope: "col" }, "octets"));
    }
    const body = make("tbody");
    for (const { level, name } of LEVELS) {
      const row = make("tr", {}, make("th", { scope: "row" }, name));
      for (const direction of DIRECTIONS) {
        const queue = `link.${direction}.queue.${level}`;
        row.append(figure(`${queue}.oldest_age_ns`, "1e-6", "1"), figure(`${queue}.octets`, "1", "0"));
      }
      body.append(row);
    }
    const rows = ["packets dropped", "frames lost", "slots left out"].map((name) =>
      make("tr", {}, make("th", { scope: "row" }, name)),
    );
    for (const direction of DIRECTIONS) {
      const cells = rows.map((row) => {
        const cell = make("td", { class: "number", colspan: "2" }, "–");
        row.append(cell);
        return cell;
      });
      this.#counts.set(direction, cells);
    }
    const late = make("tr", {}, make("th", { scope: "row" }, "slots late, p99, µs"));
    for (const direction of DIRECTIONS) {
      const cell = figure(`link.${direction}.lateness_us.p99`, "1", "0");
      cell.colSpan = 2;
      late.append(cell);
    }
    this.append(make("table", {}, make("thead", {}, head, units), body, make("tbody", {}, ...rows, late)));
  }

  /** @param {Readonly<Record<string, LinkCounts>>} link By direction. */
  update(link) {
    for (const [direction, { drops, lost, slips }] of Object.entries(link)) {
      const cells = this.#counts.get(direction) ?? [];
      const dropped = Object.entries(drops).filter(([, number]) => number > 0);
      const sum = dropped.reduce((total, [, number]) => total + number, 0);
      [sum, lost, slips].forEach((number, index) => {
        setText(cells[index], count(number));
        setAttribute(cells[index], "data-some", String(number > 0));
      });
      setAttribute(cells[0], "title", dropped.map(([why, number]) => `${why}: ${number}`).join(", "));
    }
  }
}

customElements.define("link-table", LinkTable);

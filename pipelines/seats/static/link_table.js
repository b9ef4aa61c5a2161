/**
 * `<link-table>`: what waits at each level of both directions and for how long, what the link lost,
 * and the path to another machine.
 *
 * @import { Seat } from "./seat.js"
 * @import { Figure } from "./texts.js"
 */
import { make, setAttribute, setText } from "./dom.js";
import { countsBelow } from "./figure_binding.js";
import { pathList } from "./path_list.js";
import { countText } from "./wording.js";

const DIRECTIONS = ["uplink", "downlink"];
/** The levels of the link's sender that have a queue, by falling priority. */
const LEVELS = [
  { level: "tmtc", name: "TM/TC" },
  { level: "voice", name: "voice" },
  { level: "video", name: "pictures" },
  { level: "maintenance", name: "maintenance" },
];

/** @param {string} name @param {string} scale @param {string} decimals */
const figure = (name, scale, decimals) =>
  make("td", { class: "number", "data-figure-in": name, "data-scale": scale, "data-decimals": decimals });

class LinkTable extends HTMLElement {
  /** By direction: the cells of drops, losses and slips. @type {Map<string, HTMLElement[]>} */
  #counts = new Map();

  /** @param {Seat} seat */
  follow(seat) {
    const head = make("tr", {}, make("td"));
    const units = make("tr", { class: "units" }, make("th", { scope: "col" }, "queue"));
    for (const direction of DIRECTIONS) {
      head.append(make("th", { scope: "colgroup", colspan: "2" }, direction));
      units.append(make("th", { scope: "col" }, "oldest, ms"), make("th", { scope: "col" }, "bytes"));
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
    this.append(
      make("table", {}, make("thead", {}, head, units), body, make("tbody", {}, ...rows, late)),
      pathList(seat),
    );
    seat.connection.on("figures", ({ figures }) => this.#show(figures));
  }

  /** @param {Readonly<Record<string, Figure>>} figures */
  #show(figures) {
    for (const [direction, cells] of this.#counts) {
      const link = `link.${direction}`;
      const dropped = Object.entries(countsBelow(figures, `${link}.queue.`)).filter(
        ([name, number]) => name.includes(".drops.") && number > 0,
      );
      const sum = dropped.reduce((total, [, number]) => total + number, 0);
      const counts = [sum, Number(figures[`${link}.frames_lost`]), Number(figures[`${link}.slips`])];
      counts.forEach((number, index) => {
        setText(cells[index], countText(number));
        setAttribute(cells[index], "data-some", String(number > 0));
      });
      const title = dropped.map(([name, number]) => `${name.replace(".drops.", ", ")}: ${number}`).join("; ");
      setAttribute(cells[0], "title", title);
    }
  }
}

customElements.define("link-table", LinkTable);

/**
 * `<link-octets>`: both directions of the link over the last minute, stacked by what their octets
 * carried. Idle fill is a number only: it would hide what is carried.
 *
 * @import { Seat } from "./seat.js"
 */
import { make, setText } from "./dom.js";
import { countsBelow } from "./figure_binding.js";
import { LAYERS, OctetHistory } from "./octet_history.js";
import { paint } from "./palette.js";
import { SharpCanvas } from "./sharp_canvas.js";
import { rateText } from "./wording.js";

/** Readings that are shown: a minute, one a second. */
const COLUMNS = 60;
const STEPS_BPS = [64e3, 128e3, 256e3, 512e3, 1e6, 2e6, 4e6, 8e6, 16e6, 32e6, 64e6, 128e6];

/** One direction: its chart, and its column of the table. */
class Direction {
  #history = new OctetHistory(COLUMNS);
  #sharp = new SharpCanvas(() => this.#draw());
  #top = make("span", { class: "strip-top" });
  #capacity = make("span", { class: "quiet small" });
  /** The cells of the table by row: layers, their sum, idle fill and repair. */
  cells = [...LAYERS, "sum", "idle"].map(() => make("td"));

  /** @param {string} name */
  constructor(name) {
    const { canvas } = this.#sharp;
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", `${name}: rates by what was carried, over a minute`);
    this.name = name;
    this.chart = make(
      "section",
      {},
      make("header", {}, make("h2", {}, name), this.#capacity),
      make("div", { class: "octets-chart" }, this.#top, canvas),
    );
  }

  /** @param {number} atUs @param {Readonly<Record<string, number>>} octets @param {unknown} capacityBps */
  update(atUs, octets, capacityBps) {
    const history = this.#history;
    history.append(atUs, octets);
    const newest = history.appended - 1;
    const rates = LAYERS.map((_, layer) => history.rate(newest, layer));
    [...rates, history.total(newest), history.idleBps].forEach((bps, row) => {
      setText(this.cells[row], rateText(bps));
    });
    setText(this.#capacity, `capacity ${rateText(capacityBps)}`);
    this.#draw();
  }

  #draw() {
    const { width, height } = this.#sharp;
    if (width === 0) return;
    const context = this.#sharp.cleared();
    const history = this.#history;
    const fullBps = this.#full();
    setText(this.#top, rateText(fullBps));
    context.fillStyle = paint("--line");
    for (let quarter = 0; quarter < 4; quarter += 1) {
      context.fillRect(0, Math.round((quarter * height) / 4), width, 1);
    }
    const step = width / COLUMNS;
    for (let column = 0; column < COLUMNS; column += 1) {
      const reading = history.appended - COLUMNS + column;
      let bottom = height;
      LAYERS.forEach((layer, index) => {
        const bps = history.rate(reading, index);
        if (!(bps > 0)) return;
        const tall = (bps / fullBps) * height;
        context.fillStyle = paint(layer.colour);
        context.fillRect(Math.round(column * step), bottom - tall, Math.ceil(step), tall);
        bottom -= tall;
      });
    }
  }

  /** The rate at the top of the chart. */
  #full() {
    let most = 0;
    for (let back = 1; back <= COLUMNS; back += 1) {
      const total = this.#history.total(this.#history.appended - back);
      if (total > most) most = total;
    }
    return STEPS_BPS.find((step) => step >= most) ?? most;
  }
}

class LinkOctets extends HTMLElement {
  /** @param {Seat} seat */
  follow({ connection }) {
    const directions = ["uplink", "downlink"].map((name) => new Direction(name));
    const axis = make("p", { class: "time-axis" }, make("span", {}, "60 s ago"), make("span", {}, "now"));
    const charts = make("div", { class: "octets-charts" }, ...directions.map(({ chart }) => chart), axis);
    this.append(charts, legend(directions));
    connection.on("figures", ({ at_us, figures }) => {
      for (const direction of directions) {
        const link = `link.${direction.name}`;
        direction.update(at_us, countsBelow(figures, `${link}.octets.`), figures[`${link}.capacity_bps`]);
      }
    });
  }
}

/** The table of the newest rates. @param {readonly Direction[]} directions */
function legend(directions) {
  const body = make("tbody");
  const row = (/** @type {string} */ name, /** @type {number} */ cell, /** @type {string} */ layer) => {
    const swatch = make("i", { class: "swatch", "data-layer": layer });
    const head = make("th", { scope: "row" }, swatch, name);
    body.append(make("tr", {}, head, ...directions.map(({ cells }) => cells[cell])));
  };
  // From top to bottom as in the stack, so that rows find their layers without colour.
  for (let layer = LAYERS.length - 1; layer >= 0; layer -= 1) row(LAYERS[layer].name, layer, String(layer));
  row("all of these", LAYERS.length, "none");
  row("idle fill, repair", LAYERS.length + 1, "none");
  const heads = directions.map(({ name }) => make("th", { scope: "col" }, name));
  return make("table", { class: "octets-legend" }, make("thead", {}, make("tr", {}, make("td"), ...heads)), body);
}

customElements.define("link-octets", LinkOctets);

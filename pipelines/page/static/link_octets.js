/**
 * `<link-octets>`: one direction of the link over the last minute, stacked by what its octets
 * carried. Idle fill is a number only: it would hide what is carried.
 *
 * @import { LinkCounts } from "./texts.js"
 */
import { fitCanvas } from "./canvas_size.js";
import { startDrawing, stopDrawing } from "./drawing_loop.js";
import { make, setText } from "./make.js";
import { LAYERS, OctetHistory } from "./octet_history.js";
import { token, tokenGeneration } from "./tokens.js";
import { rate } from "./wording.js";

/** Readings that are shown: a minute, two a second. */
const COLUMNS = 120;
const STEPS_BPS = [64e3, 128e3, 256e3, 512e3, 1e6, 2e6, 4e6, 8e6, 16e6, 32e6, 64e6, 128e6];

export class LinkOctets extends HTMLElement {
  #history = new OctetHistory(COLUMNS);
  #drawn = "";
  #canvas = make("canvas", { role: "img" });
  #context = /** @type {CanvasRenderingContext2D} */ (this.#canvas.getContext("2d"));
  #top = make("span", { class: "strip-top" });
  #legend = make("tbody");
  /** @type {HTMLElement[]} */
  #rates = [];
  #idle = make("td", { class: "number" });
  #total = make("td", { class: "number" });

  connectedCallback() {
    if (this.childElementCount === 0) this.#build();
    startDrawing(this);
  }

  disconnectedCallback() {
    stopDrawing(this);
  }

  /** @param {number} atUs @param {LinkCounts} counts */
  update(atUs, counts) {
    this.#history.append(atUs, counts.octets);
    const newest = this.#history.appended - 1;
    LAYERS.forEach((_, layer) => setText(this.#rates[layer], rate(this.#history.rate(newest, layer))));
    setText(this.#total, rate(this.#history.total(newest)));
    setText(this.#idle, rate(this.#history.idleBps));
  }

  /** Bring the canvas up to date; called by the drawing loop. */
  draw() {
    const history = this.#history;
    const resized = fitCanvas(this.#canvas);
    const what = `${history.appended} ${tokenGeneration()}`;
    if (!resized && what === this.#drawn) return;
    this.#drawn = what;
    const context = this.#context;
    const { width, height } = this.#canvas;
    const fullBps = this.#full();
    setText(this.#top, rate(fullBps));
    context.clearRect(0, 0, width, height);
    context.fillStyle = token("--line");
    for (let quarter = 0; quarter < 4; quarter += 1) {
      context.fillRect(0, Math.round((quarter * height) / 4), width, 1);
    }
    const step = width / COLUMNS;
    for (let column = 0; column < COLUMNS; column += 1) {
      const reading = history.appended - COLUMNS + column;
      const left = Math.round(column * step);
      const wide = Math.round((column + 1) * step) - left;
      let bottom = height;
      for (let layer = 0; layer < LAYERS.length; layer += 1) {
        const bps = history.rate(reading, layer);
        if (!(bps > 0)) continue;
        const tall = (bps / fullBps) * height;
        context.fillStyle = token(LAYERS[layer].token);
        context.fillRect(left, bottom - tall, wide, tall);
        bottom -= tall;
      }
    }
  }

  #full() {
    let most = 0;
    for (let back = 1; back <= COLUMNS; back += 1) {
      const total = this.#history.total(this.#history.appended - back);
      if (total > most) most = total;
    }
    return STEPS_BPS.find((step) => step >= most) ?? most;
  }

  #build() {
    const name = this.getAttribute("direction") ?? "";
    this.#canvas.setAttribute("aria-label", `${name}: rates by what was carried`);
    // From top to bottom as in the stack, so that rows find their layers without colour.
    this.#rates = LAYERS.map(() => make("td", { class: "number" }));
    const row = (/** @type {string} */ text, /** @type {HTMLElement} */ value, /** @type {string} */ key) => {
      const swatch = make("i", { class: "swatch", "data-key": key });
      this.#legend.append(make("tr", {}, make("th", { scope: "row" }, swatch, text), value));
    };
    for (let layer = LAYERS.length - 1; layer >= 0; layer -= 1) {
      row(LAYERS[layer].name, this.#rates[layer], LAYERS[layer].token.slice(2));
    }
    row("all of these", this.#total, "none");
    row("idle fill", this.#idle, "none");
    this.append(
      make("h3", {}, name),
      make(
        "div",
        { class: "octets" },
        make("div", { class: "octets-chart" }, this.#top, this.#canvas, make("p", { class: "time-axis" }, make("span", {}, "60 s ago"), make("span", {}, "now"))),
        make("table", { class: "legend-table" }, this.#legend),
      ),
    );
  }
}

customElements.define("link-octets", LinkOctets);

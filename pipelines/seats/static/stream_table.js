/**
 * `<stream-table>`: each stream's rate against its cap, its latency by stage, and what it lost.
 *
 * @import { Seat } from "./seat.js"
 * @import { Figure } from "./texts.js"
 */
import { make, setAttribute, setText } from "./dom.js";
import { millisecondsText, nameText, rateText } from "./wording.js";

/** The stages in the order in which a picture passes them, with the name of each for people. */
const STAGES = [
  { stage: "capture_to_encoded", name: "capture and encoding" },
  { stage: "encoded_to_sent", name: "pacing" },
  { stage: "sent_to_received", name: "link" },
  { stage: "received_to_displayed", name: "decoding and display" },
];
const LATENCY_STEPS_MS = [50, 100, 200, 500, 1000, 2000, 5000];

/**
 * @typedef {object} Row
 * @property {string} name Its prefix in the figures.
 * @property {HTMLElement} rate
 * @property {HTMLElement} fill
 * @property {HTMLElement} peak
 * @property {HTMLElement} bar
 * @property {HTMLElement[]} stages
 * @property {HTMLElement} worst
 * @property {HTMLElement} latency
 */

/** @param {Figure | undefined} value */
const number = (value) => (typeof value === "number" ? value : NaN);

class StreamTable extends HTMLElement {
  /** @type {Row[]} */
  #rows = [];
  #axis = make("span", { class: "axis-end" });

  /** @param {Seat} seat */
  follow({ connection, figures }) {
    connection.on("figures", (text) => {
      if (this.#show(text.figures)) figures.refresh();
    });
  }

  /** Whether there are new rows. @param {Readonly<Record<string, Figure>>} figures @returns {boolean} */
  #show(figures) {
    const names = Object.keys(figures)
      .filter((key) => key.endsWith(".cap_bps"))
      .map((key) => key.slice(0, -".cap_bps".length));
    const changed = names.join() !== this.#rows.map(({ name }) => name).join();
    if (changed) this.#build(names);
    const worst = Math.max(0, ...this.#rows.map(({ name }) => number(figures[`${name}.latency_ms.p99`]) || 0));
    const fullMs = LATENCY_STEPS_MS.find((step) => step >= worst) ?? worst;
    setText(this.#axis, millisecondsText(fullMs));
    for (const row of this.#rows) showRow(row, figures, fullMs);
    return changed;
  }

  /** @param {readonly string[]} names */
  #build(names) {
    const head = ["stream", "state", "rate", "latency, p50", "age, ms", "shown, 1/s", "lost"];
    const keys = STAGES.map(({ name }, index) =>
      make("span", { class: "key", "data-stage": String(index) }, make("i", { class: "swatch" }), name),
    );
    const body = make("tbody");
    this.#rows = names.map((name) => {
      const row = this.#row(name);
      body.append(row.element);
      return row.row;
    });
    this.replaceChildren(
      make("p", { class: "legend" }, ...keys, make("span", { class: "key" }, make("i", { class: "swatch worst" }), "p99"), "axis to ", this.#axis),
      make(
        "table",
        {},
        make("thead", {}, make("tr", {}, ...head.map((title) => make("th", { scope: "col" }, title)))),
        body,
      ),
    );
  }

  /** @param {string} name @returns {{row: Row, element: HTMLElement}} */
  #row(name) {
    const fill = make("i", { class: "fill" });
    const peak = make("i", { class: "peak", title: "the highest second" });
    const stages = STAGES.map((_, index) => make("i", { class: "stage", "data-stage": String(index) }));
    const worst = make("i", { class: "worst", title: "p99" });
    const bar = make("div", { class: "bar" }, ...stages, worst);
    const [rateText, latency] = [make("span", { class: "number" }), make("span", { class: "number" })];
    const haptic = name.startsWith("haptic.");
    const figure = (/** @type {string} */ key, /** @type {string} */ decimals) =>
      make("td", { class: "number", "data-figure-in": `${name}.${key}`, "data-decimals": decimals });
    const title = haptic ? (name === "haptic.up" ? "uplink hand" : "downlink hand") : nameText(name);
    const element = make(
      "tr",
      { "data-stream": name },
      make("th", { scope: "row" }, title),
      make("td", { class: "stream-state", "data-figure-in": `${name}.state` }),
      make("td", {}, make("div", { class: "bar" }, fill, peak), rateText),
      make("td", {}, bar, latency),
      figure("age_ms", "0"),
      figure("displayed_hz", "1"),
      figure(haptic ? "lost" : "rtp_lost", "0"),
    );
    return { row: { name, rate: rateText, fill, peak, bar, stages, worst, latency }, element };
  }
}

/** @param {Row} row @param {Readonly<Record<string, Figure>>} figures @param {number} fullMs */
function showRow(row, figures, fullMs) {
  const of = (/** @type {string} */ key) => number(figures[`${row.name}.${key}`]);
  const [now, cap, most] = [of("rate_bps"), of("cap_bps"), of("payload_bps_max_1s")];
  const share = (/** @type {number} */ part, /** @type {number} */ whole) =>
    `${Number.isFinite(part / whole) ? Math.min(100, (100 * part) / whole).toFixed(1) : 0}%`;
  setText(row.rate, `${rateText(now)} of ${rateText(cap)}`);
  row.fill.style.width = share(now, cap);
  row.peak.style.left = share(most, cap);
  row.peak.hidden = !Number.isFinite(most);
  setAttribute(row.fill, "data-over", String(most > cap));

  const [p50, p99] = [of("latency_ms.p50"), of("latency_ms.p99")];
  const stages = STAGES.map(({ stage }) => of(`latency_ms.stages.${stage}.p50`));
  const staged = stages.every(Number.isFinite);
  row.stages.forEach((part, index) => {
    // Without stages the whole is one part.
    part.style.width = share(staged ? stages[index] : index === 0 ? p50 : 0, fullMs);
  });
  row.worst.style.left = share(p99, fullMs);
  row.worst.hidden = !Number.isFinite(p99);
  const parts = STAGES.map(({ name }, index) => `${name} ${millisecondsText(stages[index])}`).join(", ");
  setAttribute(row.bar, "title", staged ? parts : null);
  setText(row.latency, `${millisecondsText(p50)}, p99 ${millisecondsText(p99)}`);
}

customElements.define("stream-table", StreamTable);

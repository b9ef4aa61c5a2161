/**
 * `<haptic-charts>`: force and position at 1 kHz over the last 2, 10 or 60 seconds, of each end of
 * haptics that this page is sent.
 *
 * @import { Connection } from "./connection.js"
 * @import { Seat } from "./seat.js"
 * @import { HapticChart } from "./texts.js"
 */
import { make } from "./dom.js";
import { drawOften } from "./drawing_loop.js";
import { HapticTrace } from "./haptic_trace.js";
import { StripChart } from "./strip_chart.js";

const SPANS_S = [2, 10, 60];
/** The one at first. */
const SPAN_S = 10;
/** The thick one is drawn below. */
const SIGNALS = [
  { end: "joystick", colour: "--end-joystick", thick: true },
  { end: "robot", colour: "--end-robot", thick: false },
];

/** Rows that are kept of each end: the longest span. */
const KEPT_ROWS = 61_000;

class HapticCharts extends HTMLElement {
  /** As `SIGNALS`. */
  #traces = SIGNALS.map(() => new HapticTrace(KEPT_ROWS));
  #keys = SIGNALS.map(({ end }) => make("span", { class: "key", "data-end": end, hidden: true }, end));
  /** Rows of each trace that the charts have already. */
  #shown = [0, 0];
  /** As the server tells them. @type {readonly HapticChart[]} */
  #charts = [];
  /** @type {StripChart[]} */
  #strips = [];
  #span = SPAN_S;
  #left = make("span");

  /** @param {Seat} seat */
  follow({ connection }) {
    this.#build();
    connection.on("hello", ({ charts }) => this.#show(charts));
    connection.on("haptic", (haptics) => {
      const signal = SIGNALS.findIndex(({ end }) => end === haptics.end);
      this.#traces[signal].append(haptics);
      this.#keys[signal].hidden = false;
    });
    drawOften(this, () => this.#draw(connection));
  }

  /** @param {Connection} connection */
  #draw(connection) {
    const nowUs = connection.nowUs();
    if (nowUs === null) return;
    this.#traces.forEach((trace, end) => {
      for (let row = Math.max(this.#shown[end], trace.oldest); row < trace.appended; row += 1) {
        this.#charts.forEach((chart, index) => put(this.#strips[index], chart, trace, end, row));
      }
      this.#shown[end] = trace.appended;
    });
    for (const strip of this.#strips) strip.draw(nowUs);
  }

  #build() {
    const spans = make("fieldset", { class: "choice" }, make("legend", { class: "only-spoken" }, "Time shown"));
    for (const span of SPANS_S) {
      const radio = make("input", { type: "radio", name: "haptic-span", value: String(span), checked: span === SPAN_S });
      radio.addEventListener("change", () => this.#choose(span));
      spans.append(make("label", {}, radio, make("span", {}, `${span} s`)));
    }
    const legend = make("p", { class: "legend" }, ...this.#keys);
    const axis = make("p", { class: "time-axis" }, this.#left, make("span", {}, "now"));
    this.append(make("div", { class: "chart-head" }, legend, spans), axis);
    this.#choose(SPAN_S);
  }

  /** @param {readonly HapticChart[]} charts */
  #show(charts) {
    if (JSON.stringify(charts) === JSON.stringify(this.#charts)) return;
    for (const strip of this.#strips) strip.remove();
    this.#charts = charts;
    this.#strips = charts.map(
      (chart) => new StripChart({ ...chart, signals: SIGNALS }, (strip) => this.#refill(strip, chart)),
    );
    this.lastElementChild?.before(...this.#strips);
    this.#choose(this.#span);
  }

  /** @param {number} seconds */
  #choose(seconds) {
    this.#span = seconds;
    this.#left.textContent = `${seconds} s ago`;
    for (const strip of this.#strips) strip.spanUs = seconds * 1e6;
  }

  /** Hands a strip the samples that it lost. @param {StripChart} strip @param {HapticChart} chart */
  #refill(strip, chart) {
    this.#traces.forEach((trace, end) => {
      for (let row = trace.oldest; row < this.#shown[end]; row += 1) put(strip, chart, trace, end, row);
    });
  }
}

/** @param {StripChart} strip @param {HapticChart} chart @param {HapticTrace} trace @param {number} end @param {number} row */
function put(strip, chart, trace, end, row) {
  const place = row % trace.capacity;
  strip.add(end, trace.timesUs[place], trace.values[chart.column][place] * chart.factor);
}

customElements.define("haptic-charts", HapticCharts);

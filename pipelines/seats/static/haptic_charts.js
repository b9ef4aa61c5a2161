/**
 * `<haptic-charts>`: force and position at 1 kHz over the last 2, 10 or 60 seconds, of each end of
 * haptics that this page is sent.
 *
 * @import { Connection } from "./connection.js"
 * @import { Seat } from "./seat.js"
 */
import { make } from "./dom.js";
import { drawOften } from "./drawing_loop.js";
import { HapticTrace, Value } from "./haptic_trace.js";
import { StripChart } from "./strip_chart.js";

const SPANS_S = [2, 10, 60];
/** The one at first. */
const SPAN_S = 10;
/** The thick one is drawn below. */
const SIGNALS = [
  { end: "joystick", colour: "--end-joystick", thick: true },
  { end: "robot", colour: "--end-robot", thick: false },
];
/** @typedef {{value: number, title: string, unit: string, factor: number, least: number}} Strip */

/** @type {readonly Strip[]} */
const STRIPS = [
  { value: Value.FORCE_X_N, title: "force x", unit: "N", factor: 1, least: 1 },
  { value: Value.FORCE_Y_N, title: "force y", unit: "N", factor: 1, least: 1 },
  { value: Value.X_M, title: "position x", unit: "mm", factor: 1000, least: 20 },
  { value: Value.Y_M, title: "position y", unit: "mm", factor: 1000, least: 20 },
];

/** Rows that are kept of each end: the longest span. */
const KEPT_ROWS = 61_000;

class HapticCharts extends HTMLElement {
  /** As `SIGNALS`. */
  #traces = SIGNALS.map(() => new HapticTrace(KEPT_ROWS));
  #keys = SIGNALS.map(({ end }) => make("span", { class: "key", "data-end": end, hidden: true }, end));
  /** Rows of each trace that the charts have already. */
  #shown = [0, 0];
  /** @type {StripChart[]} */
  #strips = [];
  #left = make("span");

  /** @param {Seat} seat */
  follow({ connection }) {
    this.#build();
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
        STRIPS.forEach((strip, index) => put(this.#strips[index], strip, trace, end, row));
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
    this.#strips = STRIPS.map(
      (strip) => new StripChart({ ...strip, signals: SIGNALS }, (chart) => this.#refill(chart, strip)),
    );
    const axis = make("p", { class: "time-axis" }, this.#left, make("span", {}, "now"));
    this.append(make("div", { class: "chart-head" }, legend, spans), ...this.#strips, axis);
    this.#choose(SPAN_S);
  }

  /** @param {number} seconds */
  #choose(seconds) {
    this.#left.textContent = `${seconds} s ago`;
    for (const strip of this.#strips) strip.spanUs = seconds * 1e6;
  }

  /** Hands a chart the samples that it lost. @param {StripChart} chart @param {Strip} strip */
  #refill(chart, strip) {
    this.#traces.forEach((trace, end) => {
      for (let row = trace.oldest; row < this.#shown[end]; row += 1) put(chart, strip, trace, end, row);
    });
  }
}

/** @param {StripChart} chart @param {Strip} strip @param {HapticTrace} trace @param {number} end @param {number} row */
function put(chart, strip, trace, end, row) {
  const place = row % trace.capacity;
  chart.add(end, trace.timesUs[place], trace.values[strip.value][place] * strip.factor);
}

customElements.define("haptic-charts", HapticCharts);

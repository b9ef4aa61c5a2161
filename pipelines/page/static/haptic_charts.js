/**
 * `<haptic-charts>`: force and position of the joystick and of the robot, at 1 kHz, over the last
 * 2, 10 or 60 seconds.
 *
 * @import { HapticTrace } from "./haptic_trace.js"
 */
import { Value } from "./haptic_trace.js";
import { make } from "./make.js";
import { StripChart } from "./strip_chart.js";

const SPANS_S = [2, 10, 60];
/** Joystick, then robot: as the ends are numbered. The thick one is drawn below. */
const SIGNALS = [
  { token: "--end-joystick", thick: true },
  { token: "--end-robot", thick: false },
];
const STRIPS = [
  { value: Value.FORCE_X_N, title: "force x", unit: "N", factor: 1, least: 1 },
  { value: Value.FORCE_Y_N, title: "force y", unit: "N", factor: 1, least: 1 },
  { value: Value.X_M, title: "position x", unit: "mm", factor: 1000, least: 20 },
  { value: Value.Y_M, title: "position y", unit: "mm", factor: 1000, least: 20 },
];

export class HapticCharts extends HTMLElement {
  /** The rows of each end, by its number; set before the first `update`.
   * @type {readonly HapticTrace[]}
   */
  traces = [];
  /** Rows of each trace that the charts have already. */
  #shown = [0, 0];
  /** @type {StripChart[]} */
  #strips = [];
  #left = make("span");
  #spanS = 10;

  connectedCallback() {
    if (this.childElementCount > 0) return;
    const spans = make("fieldset", { class: "choice" }, make("legend", { class: "unseen" }, "Time shown"));
    for (const span of SPANS_S) {
      const radio = make("input", { type: "radio", name: "haptic-span", value: String(span) });
      radio.checked = span === this.#spanS;
      radio.addEventListener("change", () => this.#choose(span));
      spans.append(make("label", {}, radio, make("span", {}, `${span} s`)));
    }
    const legend = make(
      "p",
      { class: "legend" },
      make("span", { class: "key thick", "data-end": "joystick" }, "joystick"),
      make("span", { class: "key thin", "data-end": "robot" }, "robot"),
    );
    this.append(make("div", { class: "chart-head" }, legend, spans));
    for (const strip of STRIPS) {
      const chart = new StripChart();
      chart.look = { title: strip.title, unit: strip.unit, least: strip.least, signals: SIGNALS };
      chart.onempty = (emptied) => this.#refill(emptied, strip);
      this.#strips.push(chart);
      this.append(chart);
    }
    this.append(make("p", { class: "time-axis" }, this.#left, make("span", {}, "now")));
    this.#choose(this.#spanS);
  }

  /** Show what the traces got since the last call.
   * @param {number} nowUs the session's clock, the charts' right edge
   */
  update(nowUs) {
    this.traces.forEach((trace, end) => {
      for (let row = Math.max(this.#shown[end], trace.oldest); row < trace.appended; row++) {
        const place = row % trace.capacity;
        STRIPS.forEach((strip, index) => {
          const value = trace.values[strip.value][place] * strip.factor;
          this.#strips[index]?.add(end, trace.timesUs[place], value);
        });
      }
      this.#shown[end] = trace.appended;
    });
    for (const strip of this.#strips) strip.update(nowUs);
  }

  /** @param {number} seconds */
  #choose(seconds) {
    this.#spanS = seconds;
    this.#left.textContent = `${seconds} s ago`;
    for (const strip of this.#strips) strip.spanUs = seconds * 1e6;
  }

  /** Hand a chart what it lost when its size or span changed.
   * @param {StripChart} chart
   * @param {(typeof STRIPS)[number]} strip
   */
  #refill(chart, strip) {
    this.traces.forEach((trace, end) => {
      for (let row = trace.oldest; row < this.#shown[end]; row++) {
        const place = row % trace.capacity;
        chart.add(end, trace.timesUs[place], trace.values[strip.value][place] * strip.factor);
      }
    });
  }
}

customElements.define("haptic-charts", HapticCharts);

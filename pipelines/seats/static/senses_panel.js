/**
 * `<senses-panel>`: how old is what the operator sees, hears and feels, and whether people notice
 * that the senses differ.
 *
 * @import { FigureBinding } from "./figure_binding.js"
 * @import { Seat } from "./seat.js"
 */
import { make, setText } from "./dom.js";
import { NOTHING } from "./figure_binding.js";

/** @type {[string, string][]} */
const SENSES = [
  ["See", "uplink_video.age_ms"],
  ["Hear", "uplink_voice.age_ms"],
  ["Feel", "haptic.up.latency_ms.p50"],
];

/** The first comes so much after the second. @type {[string, string][]} */
const SKEWS = [
  ["Sight − touch", "video_haptic"],
  ["Sound − touch", "audio_haptic"],
  ["Sound − sight", "audio_video"],
];

/** The age that fills a bar. */
const FULL_MS = 500;
const LOOK_MS = 200;

class SensesPanel extends HTMLElement {
  /** @type {(() => void)[]} */
  #shows = [];

  /** @param {Seat} seat */
  follow({ connection, figures }) {
    this.append(
      make("header", {}, make("h2", {}, "How old is it")),
      make("div", { class: "senses" }, ...SENSES.flatMap(([what, name]) => this.#sense(figures, what, name))),
      make("dl", { class: "values skews" }, ...SKEWS.flatMap(([what, pair]) => this.#skew(figures, what, pair))),
    );
    const show = () => {
      for (const one of this.#shows) one();
    };
    connection.on("figures", show);
    setInterval(show, LOOK_MS);
  }

  /** @param {FigureBinding} figures @param {string} what @param {string} name */
  #sense(figures, what, name) {
    const bar = make("span", { class: "age-fill" });
    this.#shows.push(() => {
      const share = Math.min(1, (figures.number(name) ?? 0) / FULL_MS);
      bar.style.transform = `scaleX(${share.toFixed(3)})`;
    });
    const value = make("span", { "data-figure": name, "data-decimals": "0" });
    return [
      make("span", { class: "sense" }, what),
      make("span", { class: "age-scale" }, bar),
      make("strong", {}, value, make("span", { class: "unit" }, "ms")),
    ];
  }

  /** @param {FigureBinding} figures @param {string} what @param {string} pair */
  #skew(figures, what, pair) {
    const verdict = make("span", { class: "verdict" });
    const limits = make("dd", { class: "limits quiet small" });
    const value = make("span");
    this.#shows.push(() => {
      const skew = figures.number(`skew_ms.${pair}.p50`);
      const least = figures.number(`skew_limits_ms.${pair}.least`);
      const most = figures.number(`skew_limits_ms.${pair}.most`);
      setText(value, skew === null ? NOTHING : signed(skew));
      const known = least !== null && most !== null;
      setText(limits, known ? `unnoticed ${signed(least)} to ${signed(most)} ms` : "");
      const within = known && skew !== null ? least <= skew && skew <= most : null;
      setText(verdict, within === null ? "" : within ? "✓" : "✕");
      verdict.title = within === false ? "people notice this" : "people do not notice this";
      row.dataset.level = within === null ? "none" : within ? "good" : "bad";
    });
    const row = make("dd", {}, value, make("span", { class: "unit" }, "ms"), " ", verdict);
    return [make("dt", {}, what), row, limits];
  }
}

/** @param {number} ms */
const signed = (ms) => `${ms > 0 ? "+" : ms < 0 ? "−" : ""}${Math.abs(ms).toFixed(0)}`;

customElements.define("senses-panel", SensesPanel);

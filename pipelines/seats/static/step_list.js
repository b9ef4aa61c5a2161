/**
 * `<step-list>`: the steps of the newest run, in their order, each with the time since its selection.
 *
 * @import { Seat } from "./seat.js"
 */
import { make, setAttribute, setText } from "./dom.js";
import { STEPS } from "./mission_words.js";
import { nameText } from "./wording.js";

class StepList extends HTMLElement {
  /** @param {Seat} seat */
  follow({ connection }) {
    const run = make("span", { class: "small quiet" });
    const list = make("ol", { class: "steps" });
    const rows = STEPS.map((words) => {
      const time = make("span", { class: "number quiet small" });
      const item = make("li", {}, make("span", { class: "step-sign" }, "○"), make("span", {}, words), time);
      list.append(item);
      return { item, time };
    });
    this.append(make("header", {}, make("h2", {}, "Steps"), run), list);
    connection.on("experiment", ({ steps }) => {
      const newest = steps.at(-1);
      const done = steps.filter((one) => one.run === newest?.run);
      setText(run, newest === undefined ? "" : `${nameText(newest.task)}, run ${newest.run}`);
      const beganNs = done[0]?.at_ns ?? 0;
      STEPS.forEach((words, index) => {
        const { item, time } = rows[index];
        const step = done.find((one) => one.step === words);
        setAttribute(item, "data-done", step === undefined ? null : "true");
        setText(/** @type {Element} */ (item.firstElementChild), step === undefined ? "○" : "●");
        setText(time, step === undefined ? "" : `${((step.at_ns - beganNs) / 1e9).toFixed(1)} s`);
      });
    });
  }
}

customElements.define("step-list", StepList);

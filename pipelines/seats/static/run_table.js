/**
 * `<run-table>`: the runs that are over, the newest first, each with its result.
 *
 * @import { Seat } from "./seat.js"
 */
import { make } from "./dom.js";
import { RESULT_WORDS } from "./mission_words.js";
import { nameText } from "./wording.js";

class RunTable extends HTMLElement {
  #shown = "";

  /** @param {Seat} seat */
  follow({ connection }) {
    const head = make("tr", {}, ...["run", "task", "result"].map((word) => make("th", { scope: "col" }, word)), make("th", { scope: "col", class: "number" }, "time"));
    const body = make("tbody");
    this.append(make("header", {}, make("h2", {}, "Runs")), make("div", { class: "scrolled" }, make("table", {}, make("thead", {}, head), body)));
    connection.on("experiment", ({ runs }) => {
      const shown = runs.map(({ run, result }) => `${run}${result}`).join();
      if (shown === this.#shown) return;
      this.#shown = shown;
      body.replaceChildren(
        ...runs.toReversed().map(({ task, run, result, reason, seconds, score }) => {
          const level = result === "finished" ? "good" : "bad";
          const words = RESULT_WORDS[result] ?? result;
          return make(
            "tr",
            { "data-result": result },
            make("td", { class: "number" }, String(run)),
            make("th", { scope: "row" }, nameText(task)),
            make("td", { "data-level": level }, [words, nameText(reason || score)].filter(Boolean).join(": ")),
            make("td", { class: "number" }, seconds === null ? "–" : `${seconds.toFixed(1)} s`),
          );
        }),
      );
    });
  }
}

customElements.define("run-table", RunTable);

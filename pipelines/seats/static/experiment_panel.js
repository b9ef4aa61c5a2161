/**
 * `<experiment-panel>`: where the experiment is, from the selection of a task to its end, with start
 * and abort, and the tasks that can be selected.
 *
 * @import { Seat } from "./seat.js"
 * @import { ExperimentText } from "./texts.js"
 */
import { announce } from "./announcer.js";
import { experimentWords } from "./conditions.js";
import { make, setAttribute, setText } from "./dom.js";
import { nameText } from "./wording.js";

class ExperimentPanel extends HTMLElement {
  #phase = make("strong", { class: "phase" }, "–");
  #task = make("dd", {}, "–");
  #elemop = make("dd", {}, "–");
  #panel = make("dd", {}, "–");
  #start = make("button", { type: "button", id: "task-start", title: "in place of the cosmonaut's button" }, "Start it from here");
  #abort = make("button", { type: "button", class: "danger", id: "task-abort" }, "Abort");
  #answer = make("p", { class: "small", role: "status" });
  #list = make("ol", { class: "tasks" });
  /** By name. @type {Map<string, {item: HTMLElement, button: HTMLButtonElement, lacks: string}>} */
  #tasks = new Map();
  #listed = "";
  /** @type {Seat | null} */
  #seat = null;

  /** @param {Seat} seat */
  follow(seat) {
    this.#seat = seat;
    const { connection } = seat;
    const planned = make("p", { class: "small quiet", hidden: true }, "A plan selects the tasks of this session.");
    this.append(
      make("header", {}, make("h2", {}, "Experiment"), this.#phase),
      make("dl", { class: "values" }, ...row("Task", this.#task), ...row("Now", this.#elemop), ...row("Panel in space", this.#panel)),
      make("div", { class: "buttons" }, this.#start, this.#abort),
      this.#answer,
      make("h2", {}, "Tasks"),
      planned,
      this.#list,
    );
    this.#start.addEventListener("click", () => void this.#ask("start", []));
    this.#abort.addEventListener("click", () => void this.#ask("abort", []));
    connection.on("hello", ({ tasks }) => {
      if (!tasks) setText(this.#answer, "This session has no tasks: start it with --tasks.");
    });
    const show = () => {
      const { experiment } = connection;
      if (experiment === null) return;
      planned.hidden = !experiment.planned;
      this.#show(connection, experiment);
    };
    for (const kind of /** @type {const} */ (["experiment", "state", "figures", "lost"])) connection.on(kind, show);
  }

  /** @param {Seat["connection"]} connection @param {ExperimentText} experiment */
  #show(connection, experiment) {
    const { phase, task, run, elemop, tasks } = experiment;
    const listed = tasks.map(({ name }) => name).join();
    if (listed !== this.#listed) this.#build(tasks);
    this.#listed = listed;
    const { phase: words, panel, acts } = experimentWords(connection, experiment);
    if (this.dataset.phase !== phase) announce(words);
    this.dataset.phase = phase;
    setText(this.#phase, words);
    setText(this.#task, task === "" ? "–" : `${nameText(task)}, run ${run}`);
    setText(this.#elemop, elemop === "" ? "–" : nameText(elemop));
    setText(this.#panel, panel);
    const mayAct = acts && connection.mayAct;
    this.#start.disabled = !mayAct || phase !== "offered";
    this.#abort.disabled = !mayAct || phase === "idle" || phase === "ending";
    for (const [name, { item, button, lacks }] of this.#tasks) {
      setAttribute(item, "aria-current", phase !== "idle" && name === task ? "true" : null);
      button.disabled = !mayAct || phase !== "idle" || lacks !== "";
    }
  }

  /** @param {ExperimentText["tasks"]} tasks */
  #build(tasks) {
    this.#tasks.clear();
    const items = tasks.map(({ name, text, lacks }, index) => {
      const button = make("button", { type: "button", "data-task": name }, "Select");
      button.addEventListener("click", () => void this.#ask("select", [index]));
      const words = make("span", {}, make("strong", {}, nameText(name)), make("span", { class: "small quiet" }, text));
      if (lacks !== "") words.append(make("span", { class: "small" }, `Not available: it ${lacks}.`));
      const item = make("li", {}, words, button);
      this.#tasks.set(name, { item, button, lacks });
      return item;
    });
    this.#list.replaceChildren(...items);
  }

  /** @param {"select" | "start" | "abort"} name @param {number[]} given */
  async #ask(name, given) {
    const connection = this.#seat?.connection;
    if (connection === undefined) return;
    setText(this.#answer, `${name} …`);
    this.#answer.dataset.level = "none";
    const { ok, error } = await connection.request({ do: "command", application: "tasks", name, arguments: given });
    setText(this.#answer, ok ? "" : `refused: ${error}`);
    this.#answer.dataset.level = ok ? "good" : "bad";
  }
}

/** @param {string} name @param {HTMLElement} value */
const row = (name, value) => [make("dt", {}, name), value];

customElements.define("experiment-panel", ExperimentPanel);

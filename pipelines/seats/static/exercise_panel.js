/**
 * `<exercise-panel>`: a trainer's exercises: what each does, for how long, and which last now.
 *
 * @import { Seat } from "./seat.js"
 * @import { ExercisesText, ExerciseText } from "./texts.js"
 */
import { make, setText } from "./dom.js";
import { nameText } from "./wording.js";

const TICK_MS = 250;

/**
 * How long an exercise still lasts, in s; 0 if it does not.
 * @param {ExercisesText | null} exercises @param {ExerciseText} one @param {number | null} nowUs
 */
export function leftS(exercises, { name, camera }, nowUs) {
  if (exercises === null || nowUs === null) return 0;
  const { los_ns, joystick_ns, robot_ns, tasks_ns, cameras_ns } = exercises;
  /** @type {Record<string, number | undefined>} */
  const until = { los: los_ns, "joystick-error": joystick_ns, "robot-fault": robot_ns, "task-failed": tasks_ns, "camera-lost": cameras_ns[camera] };
  return Math.max(0, ((until[name] ?? 0) / 1e3 - nowUs) / 1e6);
}

class ExercisePanel extends HTMLElement {
  #answer = make("p", { class: "small", role: "status" });
  #reason = make("p", { class: "small", "data-level": "warn", hidden: true });
  #list = make("ol", { class: "tasks exercises" });
  #end = make("button", { type: "button", class: "main", id: "end-exercises" }, "End all");
  /** @type {(() => void)[]} */
  #shows = [];
  /** @type {ExercisesText | null} */
  #exercises = null;
  /** @type {Seat | null} */
  #seat = null;

  /** @param {Seat} seat */
  follow(seat) {
    this.#seat = seat;
    const { connection } = seat;
    this.append(make("header", {}, make("h2", {}, "What is to go wrong"), this.#end), this.#reason, this.#answer, this.#list);
    this.#end.addEventListener("click", () => void this.#ask("end", 0, ""));
    connection.on("hello", ({ exercises }) => {
      this.#exercises = null;
      this.#shows = [];
      this.#list.replaceChildren(...exercises.map((one) => this.#row(one)));
      const none = "This session has no trainer: start it with --trainer.";
      setText(this.#answer, exercises.length === 0 ? none : "");
    });
    connection.on("exercises", (exercises) => {
      this.#exercises = exercises;
    });
    setInterval(() => this.#show(), TICK_MS);
  }

  /** @param {ExerciseText} one */
  #row(one) {
    const { name, text, seconds, camera } = one;
    const words = [name === "los" ? "loss of signal" : name.replaceAll("-", " "), nameText(camera)].filter(Boolean).join(": ");
    const lasts = make("span", { class: "small", "data-level": "warn" });
    const time = make("input", { type: "number", min: "0.1", max: "3600", step: "any", value: String(seconds), "aria-label": `${words}: seconds` });
    const button = make("button", { type: "button", "data-exercise": name }, "Begin");
    button.setAttribute("aria-label", `Begin ${words}`);
    button.addEventListener("click", () => void this.#ask(name, time.valueAsNumber || 0, camera));
    this.#shows.push(() => {
      const connection = this.#seat?.connection;
      const left = connection?.alive ? leftS(this.#exercises, one, connection.nowUs()) : 0;
      setText(lasts, left > 0 ? `for ${Math.ceil(left)} s more` : "");
      button.disabled = time.disabled = this.#why !== "";
      button.title = this.#why;
    });
    const what = make("span", {}, make("strong", {}, words), make("span", { class: "small quiet" }, text), lasts);
    return make("li", {}, what, time, make("span", { class: "small quiet" }, "s"), button);
  }

  /** Why no exercise can be begun here; "" if one can. */
  get #why() {
    const connection = this.#seat?.connection;
    if (connection?.alive !== true) return "The server does not answer.";
    if (connection.hello?.role === "trainer") return "";
    return "Only the trainer begins exercises: the session's owner finds that seat at Take a seat.";
  }

  #show() {
    this.#end.disabled = this.#why !== "";
    this.#reason.hidden = this.#why === "" || this.#shows.length === 0;
    setText(this.#reason, this.#why);
    for (const show of this.#shows) show();
  }

  /** @param {string} exercise @param {number} seconds @param {string} camera */
  async #ask(exercise, seconds, camera) {
    const connection = this.#seat?.connection;
    if (connection === undefined) return;
    const { ok, error } = await connection.request({ do: "exercise", exercise, seconds, camera });
    setText(this.#answer, ok ? "" : `refused: ${error}`);
    this.#answer.dataset.level = ok ? "good" : "bad";
  }
}

customElements.define("exercise-panel", ExercisePanel);

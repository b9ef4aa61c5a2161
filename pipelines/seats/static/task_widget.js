/**
 * `<task-widget>`: over the picture, while a task runs: what to do now, where on the board, also in
 * words, how far it is and how much time is left.
 *
 * @import { Row } from "./newest_row.js"
 * @import { Seat } from "./seat.js"
 * @import { BoardText, PanelText } from "./texts.js"
 */
import { follows, panelShown } from "./conditions.js";
import { make, setAttribute, setText } from "./dom.js";
import { GOAL_WORDS } from "./mission_words.js";
import { NewestRow } from "./newest_row.js";
import { onNextFrame } from "./next_frame.js";
import { wayText } from "./wording.js";
import { WorkspaceMap } from "./workspace_map.js";

/** The mark of a force stands here on its bar, as a share of it. */
const MARK = 0.6;
/** So many points ahead of the handle a way is to be followed. */
const AHEAD = 2;
/** Nearer to where it begins, the spring can be pulled. */
const NEAR_M = 0.001;
/** Nearer to the partner's hand, it can be pushed. */
const TOUCH_M = 0.02;
/** Nearer to its mark, a force is held. */
const HELD_N = 0.3;

class TaskWidget extends HTMLElement {
  #map = new WorkspaceMap();
  #what = make("strong");
  #where = make("span", { class: "small" });
  #step = make("span", { class: "small" });
  #bar = make("progress", { max: "1", value: "0", "aria-label": "How far it is" });
  #gauge = make("div", { class: "task-gauge" }, this.#bar);
  #left = make("span", { class: "small" });
  /** @type {Seat | null} */
  #seat = null;
  /** @type {NewestRow | null} */
  #newest = null;

  /** @param {Seat} seat */
  follow(seat) {
    const { connection } = seat;
    this.#seat = seat;
    this.hidden = true;
    const { canvas } = this.#map;
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", "The task board with the handle and its goal");
    this.append(canvas, this.#what, this.#where, this.#step, this.#gauge, this.#left);
    const newest = new NewestRow(connection, "joystick");
    const redraw = onNextFrame(() => this.#show());
    this.#newest = newest;
    newest.onchange = redraw;
    for (const kind of /** @type {const} */ (["panel", "state", "values", "lost"])) connection.on(kind, redraw);
  }

  #show() {
    const connection = this.#seat?.connection;
    const hello = connection?.hello ?? null;
    const panel = connection?.panel ?? null;
    const runs = connection !== undefined && panel !== null && panelShown(connection, panel).mode === "running";
    this.hidden = !runs || panel.goal === "" || hello === null;
    if (this.hidden || panel === null || hello === null) return;
    this.dataset.goal = panel.goal;
    const row = this.#newest?.row ?? null;
    // What reaches the goal is the tip, which a press anew may leave beside the handle.
    const tip = connection !== undefined && follows(connection) ? this.#seat?.prediction.tip : null;
    const handle = row === null ? null : { ...row, ...tip };
    this.#map.show({ workspace: hello.workspace, board: hello.board, handle, target: null, start: null, task: panel });
    setText(this.#what, GOAL_WORDS[panel.goal] ?? panel.goal);
    const { share, words } = progressOf(panel, this.#newest?.forceN ?? 0);
    setText(this.#step, words);
    setText(this.#where, whereTo(panel, hello.board, handle));
    this.#bar.hidden = share === null;
    this.#bar.value = share ?? 0;
    setAttribute(this.#gauge, "data-mark", panel.force_n > 0 ? `${panel.force_n} N` : null);
    setText(this.#left, panel.left_s === null ? "" : `${Math.ceil(panel.left_s)} s left`);
  }
}

/**
 * Where to move the handle, in words; "" where it need not move, and while its place is not known.
 * @param {PanelText} panel @param {BoardText} board @param {Row | null} handle
 */
export function whereTo({ goal, target_m: target, force_n: markN }, board, handle) {
  if (handle === null) return "";
  const { xM, yM } = handle;
  const [springX, springY] = board.spring_m ?? [0, 0];
  if (goal === "spring" && xM < springX + NEAR_M) {
    const missingN = markN - Math.hypot(handle.forceXN, handle.forceYN);
    if (Math.abs(missingN) < HELD_N) return "hold still";
    return missingN > 0 ? "a little further left" : "a little to the right";
  }
  if (goal === "hands" && target !== null && Math.hypot(target[0] - xM, target[1] - yM) < TOUCH_M) return "push on";
  const way = board.paths_m?.[goal] ?? [];
  const follows = target === null && way.length > 0;
  const to = goal === "spring" ? [springX, springY] : follows ? nextOn(way, xM, yM, goal === "contour") : target;
  return to === null ? "" : wayText((to[0] ?? xM) - xM, (to[1] ?? yM) - yM);
}

/** What comes next on a way. @param {[number, number][]} way @param {number} xM @param {number} yM @param {boolean} closed */
function nextOn(way, xM, yM, closed) {
  const away = way.map(([x, y]) => Math.hypot(x - xM, y - yM));
  const at = away.indexOf(Math.min(...away)) + AHEAD;
  return way[closed ? at % way.length : Math.min(at, way.length - 1)] ?? [xM, yM];
}

/** How far a goal is, 0 to 1, and in words. @param {PanelText} panel @param {number} forceN @returns {{share: number | null, words: string}} */
function progressOf({ goal, step, steps, percent, force_n: markN, held_s: heldS, hold_s: holdS }, forceN) {
  const holding = heldS > 0 ? `hold: ${Math.max(0, holdS - heldS).toFixed(1)} s more` : "";
  if (goal === "spring" || goal === "hands") {
    const words = holding || `${forceN.toFixed(1)} N of ${markN.toFixed(1)} N`;
    return { share: Math.min(1, (MARK * forceN) / markN), words };
  }
  if (goal === "contour" || goal === "line") return { share: percent / 100, words: `${percent} %` };
  const which = steps > 1 ? `${step} of ${steps}` : "";
  const words = [which, holding].filter(Boolean).join(" · ");
  return { share: holdS > 0 ? heldS / holdS : null, words };
}

customElements.define("task-widget", TaskWidget);

/**
 * `<board-overlay>`: over a picture, what is to be done, and from 0.5 s of round trip on where the
 * tip will be: the picture is older than the hand. Only of cameras whose view of the board is known.
 *
 * @import { Seat } from "./seat.js"
 */
import { follows, panelShown } from "./conditions.js";
import { make, setText } from "./dom.js";
import { NewestRow } from "./newest_row.js";
import { onNextFrame } from "./next_frame.js";
import { pageMs } from "./page_clock.js";
import { PictureView } from "./picture_view.js";
import { SharpCanvas } from "./sharp_canvas.js";
import { fitted, shareOf } from "./tip_prediction.js";
import { drawGoal } from "./workspace_map.js";

/** From this round trip on the predicted tip is shown. */
const LONG_MS = 500;
/** After a change of the camera its first picture may take this much longer than the picture's age. */
const SWITCH_MS = 300;
/** What the robot tells of itself, its unit in metres, and the names of x and y. */
const TOLD = /** @type {const} */ ([
  ["offset", 0.001, "offset_x", "offset_y"],
  ["place", 1, "x", "y"],
]);
const RADIUS = 11;
/** Colours over the picture are those of the dark theme in both. */
const TIP = "#ffd24d";
const GOAL = "#7ee0a3";

class BoardOverlay extends HTMLElement {
  #redraw = onNextFrame(() => this.#show());
  #sharp = new SharpCanvas(this.#redraw);
  #words = make("span", { role: "status" });
  #button = make("button", { type: "button" });
  #note = make("div", { class: "tip-note", hidden: true }, this.#words, this.#button);
  #shown = true;
  /** @type {Seat | null} */
  #seat = null;
  /** @type {NewestRow | null} */
  #hand = null;
  #camera = "";
  #cameraMs = 0;

  /** @param {Seat} seat */
  follow(seat) {
    const { connection, keyboard } = seat;
    this.#seat = seat;
    this.append(this.#sharp.canvas, this.#note);
    this.#hand = new NewestRow(connection, "joystick");
    this.#hand.onchange = () => this.#handleHand();
    connection.on("values", ({ values }) => {
      const roundTripMs = this.#roundTripMs();
      for (const [what, scale, ...names] of TOLD) {
        const [x, y] = names.map((name) => values.find((one) => one.application === "robot" && one.name === name));
        if (typeof x?.value !== "number" || typeof y?.value !== "number" || roundTripMs === null) continue;
        seat.prediction.handleTold(what, { xM: scale * x.value, yM: scale * y.value }, x.at_us, roundTripMs);
      }
      this.#redraw();
    });
    for (const kind of /** @type {const} */ (["panel", "state", "lost"])) connection.on(kind, this.#redraw);
    const toggle = () => {
      this.#shown = !this.#shown;
      this.#redraw();
    };
    this.#button.addEventListener("click", toggle);
    // A press on the picture is the dead-man button.
    this.#note.addEventListener("pointerdown", (event) => event.stopPropagation());
    keyboard.add({ keys: ["p"], what: "show or hide the predicted tip", down: toggle });
  }

  /** From a motion of the hand to the picture of it; null while it is not known. */
  #roundTripMs() {
    const view = this.closest("picture-view");
    const ageMs = view instanceof PictureView ? view.ageMs() : null;
    // The way up is as long as the measured way down.
    const wayMs = this.#seat?.figures.number("haptic.up.latency_ms.p50") ?? null;
    return ageMs === null || wayMs === null ? null : ageMs + wayMs;
  }

  #handleHand() {
    const row = this.#hand?.row ?? null;
    const nowUs = this.#seat?.connection.nowUs() ?? null;
    if (nowUs === null || row === null) this.#seat?.prediction.forget();
    else this.#seat?.prediction.handleHand(row, row.deadMan, nowUs);
    this.#redraw();
  }

  /** The camera whose picture is shown. @param {number | null} roundTripMs */
  #view(roundTripMs) {
    const { hello = null, state = null } = this.#seat?.connection ?? {};
    const camera = state?.camera ?? "";
    if (camera !== this.#camera) [this.#camera, this.#cameraMs] = [camera, pageMs()];
    if (pageMs() - this.#cameraMs < (roundTripMs ?? 0) + SWITCH_MS) return null;
    return hello?.views?.[camera] ?? null;
  }

  #show() {
    const connection = this.#seat?.connection;
    const canvas = this.closest("picture-view")?.querySelector("canvas#picture");
    const context = this.#sharp.cleared();
    const roundTripMs = this.#roundTripMs();
    const view = this.#view(roundTripMs);
    const long = view !== null && roundTripMs !== null && roundTripMs >= LONG_MS;
    this.#note.hidden = !long;
    if (connection === undefined || view === null || !(canvas instanceof HTMLCanvasElement)) return;
    const { left, top, wide, high } = fitted(this.#sharp.width, this.#sharp.height, canvas.width / canvas.height);
    /** @param {number} xM @param {number} yM @returns {[number, number] | null} */
    const at = (xM, yM) => {
      const share = shareOf(view, xM, yM);
      return share === null ? null : [left + share.x * wide, top + share.y * high];
    };
    const { hello, panel } = connection;
    if (hello !== null && panel !== null && panelShown(connection, panel).mode === "running" && panel.goal !== "") {
      drawGoal(context, panel, hello.board, at, GOAL);
    }
    const tip = follows(connection) ? this.#seat?.prediction.tip ?? null : null;
    const drawn = long && this.#shown && tip !== null ? at(tip.xM, tip.yM) : null;
    this.dataset.tip = drawn === null ? "" : drawn.map(Math.round).join(" ");
    if (drawn !== null) drawTip(context, ...drawn);
    if (!long) return;
    setText(this.#words, this.#shown ? `◎ where the tip will be: the picture is ${(roundTripMs / 1000).toFixed(1)} s behind your hand` : "The predicted tip is hidden.");
    setText(this.#button, this.#shown ? "Hide" : "Show");
  }
}

/** @param {CanvasRenderingContext2D} context @param {number} x @param {number} y */
function drawTip(context, x, y) {
  for (const [style, width] of /** @type {const} */ ([["#05080b", 5], [TIP, 2.5]])) {
    context.strokeStyle = style;
    context.lineWidth = width;
    context.beginPath();
    context.arc(x, y, RADIUS, 0, 2 * Math.PI);
    for (const [alongX, alongY] of /** @type {const} */ ([[1, 0], [-1, 0], [0, 1], [0, -1]])) {
      context.moveTo(x + 4 * alongX, y + 4 * alongY);
      context.lineTo(x + 18 * alongX, y + 18 * alongY);
    }
    context.stroke();
  }
}

customElements.define("board-overlay", BoardOverlay);

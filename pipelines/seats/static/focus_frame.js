/**
 * `<focus-frame>`: over a picture, a thin frame around the part that is coded finer. With `chooses`,
 * a person chooses it by a tap or a drag: after *Focus*, where a press on the picture is the hand's.
 *
 * @import { Seat } from "./seat.js"
 */
import { make, setText } from "./dom.js";
import { fitted } from "./tip_prediction.js";

/** The sides that a tap chooses, as a share of the picture's. */
const TAPPED = 0.25;
/** A shorter drag is a tap, in CSS pixels; a side is at least this share of the picture's. */
const SHORT_PX = 8;
const LEAST = 0.02;

/** @param {number} share @param {number} [most] */
const within = (share, most = 1) => Math.min(Math.max(share, 0), most);

class FocusFrame extends HTMLElement {
  #part = make("div", { class: "focus-part", hidden: true });
  #words = make("span", { class: "small", role: "status" });
  #choose = make("button", { type: "button" }, "Focus");
  #off = make("button", { type: "button", "aria-label": "No focus" }, "✕");
  #tools = make("div", { class: "focus-tools" }, this.#choose, this.#off, this.#words);
  /** @type {Seat | null} */
  #seat = null;
  #armed = false;
  /** What a person draws, or has asked for and the ground has not acknowledged. @type {string | null} */
  #pending = null;
  /** What the ground has told last. */
  #told = "off";

  /** @param {Seat} seat */
  follow(seat) {
    this.#seat = seat;
    const { connection, keyboard } = seat;
    this.append(this.#part);
    const show = () => this.#show();
    connection.on("values", ({ values }) => {
      const told = values.find(({ application, name }) => application === "camera" && name === "focus")?.value;
      this.#told = typeof told === "string" ? told : this.#told;
      show();
    });
    connection.on("state", show);
    connection.on("lost", show);
    if (!this.hasAttribute("chooses")) return;
    this.append(this.#tools);
    const arm = () => this.#arm(!this.#armed && connection.mayAct);
    const remove = () => void this.#ask("off");
    this.#choose.addEventListener("click", arm);
    this.#off.addEventListener("click", remove);
    // Captured, because a press on the picture is the hand's dead-man button.
    this.parentElement?.addEventListener("pointerdown", (press) => this.#press(press), { capture: true });
    keyboard.add(
      { keys: ["f"], what: "choose the part of the picture that is coded finer", down: arm },
      { keys: ["Backspace", "Delete"], shown: "Backspace", what: "code no part finer", down: remove },
    );
  }

  /** @param {boolean} armed @param {string} [words] */
  #arm(armed, words = armed ? "tap or drag on the picture" : "") {
    this.#armed = armed;
    setText(this.#words, words);
    this.#show();
  }

  /** @param {PointerEvent} press */
  #press(press) {
    const { hello, mayAct = false } = this.#seat?.connection ?? {};
    const tool = press.target instanceof Node && this.#tools.contains(press.target);
    // The hand steers elsewhere, or this press is not its own.
    if (tool) press.stopPropagation();
    if (tool || !press.isPrimary || press.button !== 0 || !(this.#armed || (mayAct && hello?.joystick !== "page"))) return;
    press.preventDefault();
    press.stopImmediatePropagation();
    this.setPointerCapture(press.pointerId);
    this.onpointermove = (move) => {
      this.#pending = this.#between(press, move);
      this.#show();
    };
    this.onpointerup = (release) => void this.#ask(this.#between(press, release));
    this.onpointercancel = () => this.#end(null);
  }

  /** No press is under way. @param {string | null} pending @param {string} [words] */
  #end(pending, words = "") {
    this.onpointermove = this.onpointerup = this.onpointercancel = null;
    this.#pending = pending;
    this.#arm(false, words);
  }

  /** Where the picture is in this box. */
  #box() {
    const canvas = this.parentElement?.querySelector("canvas");
    return fitted(this.clientWidth, this.clientHeight, canvas ? canvas.width / canvas.height : 4 / 3);
  }

  /** What a drag chooses: left and upper edge, width and height, as shares of the picture. @param {PointerEvent} press @param {PointerEvent} release */
  #between(press, release) {
    const { left, top, wide, high } = this.#box();
    const { x, y } = this.getBoundingClientRect();
    const short = Math.hypot(release.clientX - press.clientX, release.clientY - press.clientY) < SHORT_PX;
    /** @param {number} from @param {number} to @param {number} length */
    const side = (from, to, length) => {
      if (short) return [within(from / length - TAPPED / 2, 1 - TAPPED), TAPPED];
      const [low, high] = [within(Math.min(from, to) / length, 1 - LEAST), within(Math.max(from, to) / length)];
      return [low, Math.max(high - low, LEAST)];
    };
    const [across = 0, width = 0] = side(press.clientX - x - left, release.clientX - x - left, wide);
    const [down = 0, height = 0] = side(press.clientY - y - top, release.clientY - y - top, high);
    return [across, down, width, height].map((share) => Number(share.toFixed(3))).join(",");
  }

  /** @param {string} part */
  async #ask(part) {
    const connection = this.#seat?.connection;
    if (connection === undefined) return;
    this.#end(part, "waiting for the acknowledgement …");
    const { ok, error } = await connection.request({ do: "command", application: "camera", name: "focus", arguments: [part] });
    if (this.#pending !== part) return;
    if (ok) this.#told = part;
    this.#end(null, ok ? "" : `✕ ${error}`);
  }

  #show() {
    const { connection, figures } = /** @type {Seat} */ (this.#seat);
    // Where nobody has chosen, the sender may follow the robot's tip. It tells so as a figure.
    const used = this.#told === "off" ? figures.get("processes.uplink_video_send.in_focus") : this.#told;
    const [across = 0, down = 0, width = 0, height = 0] = String(this.#pending ?? used).split(",").map(Number);
    this.#part.hidden = !connection.alive || !(width > 0);
    this.#part.dataset.pending = String(this.#pending !== null);
    const { left, top, wide, high } = this.#box();
    const sides = { left: left + across * wide, top: top + down * high, width: width * wide, height: height * high };
    for (const [name, pixels] of Object.entries(sides)) this.#part.style.setProperty(name, `${pixels.toFixed(1)}px`);
    this.#tools.hidden = !connection.mayAct;
    this.#off.hidden = this.#told === "off";
    this.#choose.setAttribute("aria-pressed", String(this.#armed));
    this.dataset.armed = String(this.#armed);
  }
}

customElements.define("focus-frame", FocusFrame);

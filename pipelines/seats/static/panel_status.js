/**
 * `<panel-status>`: what the state machine of the mission control panel says, and the button that
 * moves it on: on the page, the key Enter, or the first button of a game controller. It hides in a
 * session without tasks, unless it is `always` there.
 *
 * @import { Seat } from "./seat.js"
 * @import { PanelText } from "./texts.js"
 */
import { announce } from "./announcer.js";
import { panelShown } from "./conditions.js";
import { holdsDeadMan } from "./controller_hand.js";
import { make, setText } from "./dom.js";
import { BUTTON_WORDS, PANEL_WORDS } from "./mission_words.js";
import { nameText, wayText } from "./wording.js";

const LOOK_MS = 30;

class PanelStatus extends HTMLElement {
  #mode = make("strong", { class: "panel-mode" }, "–");
  #words = make("p", { class: "panel-words", role: "status" });
  #away = make("p", { class: "panel-away", hidden: true });
  #held = make("progress", { value: "0", "aria-label": "Held", hidden: true });
  #left = make("p", { class: "small quiet", hidden: true });
  #button = make("button", { type: "button", class: "main", id: "panel-button", hidden: true });
  #label = make("span");
  #error = make("p", { class: "small", role: "alert", "data-level": "bad" });
  #asking = false;
  /** @type {PanelText | null} */
  #panel = null;
  /** @type {Seat | null} */
  #seat = null;

  /** @param {Seat} seat */
  follow(seat) {
    this.#seat = seat;
    const { connection, keyboard } = seat;
    this.#button.append(this.#label, make("kbd", {}, "Enter"));
    this.append(make("header", {}, make("h2", {}, "What to do"), this.#mode), this.#words, this.#away, this.#held, this.#left, this.#button, this.#error);
    this.#button.addEventListener("click", () => void this.#press());
    keyboard.add({ keys: ["enter"], shown: "Enter", what: "the panel's button", down: () => void this.#press() });
    this.#followController();
    const always = this.hasAttribute("always");
    connection.on("hello", ({ tasks }) => {
      this.hidden = !tasks && !always;
      this.#panel = null;
      if (!tasks) setText(this.#words, "This session has no tasks: start it with --tasks.");
    });
    connection.on("panel", (panel) => {
      this.#panel = panel;
      this.#show();
    });
    for (const kind of /** @type {const} */ (["state", "lost"])) connection.on(kind, () => this.#show());
  }

  #show() {
    const connection = this.#seat?.connection;
    const panel = this.#panel;
    if (panel === null || connection === undefined) return;
    const { held_s: heldS, hold_s: holdS, left_s: leftS } = panel;
    const [[startX, startY], [x, y]] = [panel.start_m, panel.handle_m];
    const { mode, words } = panelShown(connection, panel);
    if (this.dataset.mode !== mode) {
      this.dataset.mode = mode;
      setText(this.#error, "");
      announce(words);
    }
    setText(this.#mode, PANEL_WORDS[mode] ?? mode);
    setText(this.#words, nameText(words));
    this.#away.hidden = mode !== "move_to_start";
    setText(this.#away, `Go ${wayText(startX - x, startY - y)}`);
    this.#held.hidden = mode !== "hold";
    this.#held.max = holdS || 1;
    this.#held.value = Math.min(this.#held.max, heldS);
    this.#left.hidden = leftS === null || !connection.alive || mode === "no_contact";
    const what = mode === "running" ? "left" : "to begin";
    setText(this.#left, leftS === null ? "" : `${Math.ceil(leftS)} s ${what}`);
    const does = BUTTON_WORDS[mode];
    this.#button.hidden = does === undefined;
    this.#button.disabled = this.#asking || !connection.alive || !connection.mayAct;
    setText(this.#label, does ?? "");
  }

  async #press() {
    const connection = this.#seat?.connection;
    const mode = this.#panel?.mode ?? "";
    if (connection === undefined || this.#asking || BUTTON_WORDS[mode] === undefined) return;
    this.#asking = true;
    this.#show();
    const { ok, error } = await connection.request({ do: "command", application: "panel", name: "button" });
    this.#asking = false;
    setText(this.#error, ok ? "" : error);
    this.#show();
  }

  #followController() {
    let pressed = false;
    const look = () => {
      const pad = navigator.getGamepads().find((one) => one?.buttons[0]?.pressed === true) ?? null;
      // While it steers, the joystick itself counts its buttons.
      const now = pad !== null && !holdsDeadMan(pad, this.#seat?.connection.hello?.pad);
      if (now && !pressed && document.hasFocus()) void this.#press();
      pressed = now;
    };
    addEventListener("gamepadconnected", () => setInterval(look, LOOK_MS), { once: true });
  }
}

customElements.define("panel-status", PanelStatus);

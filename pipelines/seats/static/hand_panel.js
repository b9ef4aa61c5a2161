/**
 * `<hand-panel picture="picture-view">`: the handle: where it is and what it feels, who has it,
 * and how to steer it.
 *
 * @import { Seat } from "./seat.js"
 * @import { PanelText, StateText } from "./texts.js"
 */
import { announce } from "./announcer.js";
import { AxisSliders } from "./axis_sliders.js";
import { boardOf, follows, situationOf } from "./conditions.js";
import { steerByController } from "./controller_hand.js";
import { make, setAttribute, setText } from "./dom.js";
import { ForceBar } from "./force_bar.js";
import { forceShare } from "./force_view.js";
import { HandControl } from "./hand_control.js";
import { steerByKeys } from "./key_hand.js";
import { AT_START } from "./mission_words.js";
import { NewestRow } from "./newest_row.js";
import { onNextFrame } from "./next_frame.js";
import { steerByPointer } from "./pointer_hand.js";
import { WorkspaceMap } from "./workspace_map.js";

const WORKSPACE = Object.freeze({ half_width_m: 0.1, half_height_m: 0.08 });

/** @typedef {"take" | "give" | "ask" | "refuse" | "policy"} HandAction */

/** @type {Record<HandAction, string>} */
const ACTIONS = { take: "Take the handle", give: "Give it up", ask: "Ask for it", refuse: "Keep it", policy: "Let the policy drive" };

export class HandPanel extends HTMLElement {
  #map = new WorkspaceMap();
  #bar = new ForceBar();
  #words = make("p", { class: "hand-words", role: "status" });
  #hint = make("p", { class: "quiet small" });
  /** @type {Record<HandAction, HTMLButtonElement>} */
  #buttons = {
    take: make("button", { type: "button", class: "main" }, ACTIONS.take),
    give: make("button", { type: "button" }, ACTIONS.give),
    ask: make("button", { type: "button" }, ACTIONS.ask),
    refuse: make("button", { type: "button" }, ACTIONS.refuse),
    policy: make("button", { type: "button" }, ACTIONS.policy),
  };
  /** @type {HandControl | null} */
  #control = null;
  /** @type {Seat | null} */
  #seat = null;
  /** @type {NewestRow | null} */
  #newest = null;
  /** Where a task begins, while that counts. @type {{xM: number, yM: number} | null} */
  #start = null;
  /** What the panel shows. @type {PanelText | null} */
  #task = null;
  /** What the last request came to. */
  #answer = "";

  /** @param {Seat} seat */
  follow(seat) {
    const { connection, keyboard } = seat;
    const control = new HandControl(connection);
    this.#seat = seat;
    this.#control = control;
    const newest = new NewestRow(connection, "joystick");
    this.#newest = newest;
    const sliders = new AxisSliders(control, keyboard);
    this.#build(sliders);
    connection.on("state", ({ joystick }) => sliders.show(joystick?.axes ?? []));
    const picture = document.querySelector(this.getAttribute("picture") ?? "picture-view");
    steerByPointer(this.#map.canvas, control, () => this.#map.halfPixels());
    if (picture instanceof HTMLElement) {
      const axis = (/** @type {string} */ wanted) => (connection.state?.joystick?.axes ?? []).findIndex(({ name }) => name === wanted);
      const head = () => ({ pan: axis("pan"), tilt: axis("tilt") });
      steerByPointer(picture, control, () => this.#pixelsOf(picture), head);
    }
    steerByKeys(keyboard, control, () => {
      const { half_width_m: x, half_height_m: y } = this.#workspace;
      return { x, y };
    });
    steerByController(control, () => forceShare(newest.forceN ?? 0), {
      mapping: () => connection.hello?.pad ?? null,
      axes: () => (connection.state?.joystick?.axes ?? []).map(({ name }) => name),
      stop: () => void connection.request({ do: "stop", action: "stop" }),
      handOver: () => (this.#buttons.policy.hidden ? this.#actByKey() : this.#handOver()),
    });
    keyboard.add(
      { keys: ["Escape"], shown: "Esc", what: "let go of the handle", down: () => control.releaseAll() },
      { keys: ["h"], what: "take the handle, ask for it, or give it up", down: () => this.#actByKey() },
      { keys: ["o"], what: "hand over to a policy", down: () => this.#handOver() },
    );
    control.addEventListener("change", () => this.#show());
    connection.on("state", () => this.#show());
    connection.on("hello", () => this.#show());
    connection.on("lost", () => this.#show());
    this.#show();
    const redraw = onNextFrame(() => this.#draw());
    newest.onchange = redraw;
    control.addEventListener("target", redraw);
    connection.on("hello", redraw);
    connection.on("panel", (panel) => {
      const { mode, start_m: [xM, yM] } = panel;
      const moved = panel.goal !== this.#task?.goal || String(panel.target_m) !== String(this.#task.target_m);
      this.#task = panel;
      if (moved) redraw();
      const start = AT_START.has(mode) ? { xM, yM } : null;
      if (start?.xM === this.#start?.xM && start?.yM === this.#start?.yM) return;
      this.#start = start;
      redraw();
    });
  }

  /** What presses and moves the handle, once the page has started. */
  get control() {
    if (this.#control === null) throw new Error("hand-panel: it follows no seat");
    return this.#control;
  }

  get #workspace() {
    return this.#seat?.connection.hello?.workspace ?? WORKSPACE;
  }

  /** @param {AxisSliders} sliders */
  #build(sliders) {
    const map = this.#map.canvas;
    map.className = "workspace-map";
    map.tabIndex = 0;
    map.setAttribute("role", "application");
    map.setAttribute("aria-label", "The handle. Hold Space and press arrow keys to move it.");
    this.append(
      make("header", {}, make("h2", {}, "Handle and force"), this.#words),
      map,
      this.#bar,
      sliders,
      make("div", { class: "buttons" }, ...Object.values(this.#buttons)),
      this.#hint,
    );
    for (const action of /** @type {HandAction[]} */ (Object.keys(ACTIONS))) {
      this.#buttons[action].addEventListener("click", () => void this.#act(action));
    }
  }

  /** The picture's height is the workspace's. @param {HTMLElement} picture */
  #pixelsOf(picture) {
    const { half_width_m, half_height_m } = this.#workspace;
    const y = picture.clientHeight / 2;
    return { x: (y * half_width_m) / half_height_m, y };
  }

  #draw() {
    const connection = this.#seat?.connection;
    const hello = connection?.hello ?? null;
    if (connection === undefined || hello === null) return;
    const handle = this.#newest?.row ?? null;
    const { half_width_m, half_height_m } = hello.workspace;
    const target = this.#control?.target ?? null;
    const mm = (/** @type {number} */ m) => (1000 * m).toFixed(1);
    setAttribute(this.#map.canvas, "data-place-mm", handle === null ? null : `${mm(handle.xM)} ${mm(handle.yM)}`);
    this.#map.show({
      workspace: hello.workspace,
      board: boardOf(connection, hello.board),
      handle,
      target: target === null ? null : { xM: target.x * half_width_m, yM: target.y * half_height_m },
      start: this.#start,
      task: this.#task,
    });
    const pressesN = this.#seat?.connection.state?.joystick?.presses_n ?? 0;
    this.#bar.show(this.#newest?.forceN ?? null, handle?.contact ?? false, pressesN);
  }

  /** @param {HandAction} action */
  async #act(action) {
    const connection = this.#seat?.connection;
    if (connection === undefined) return;
    const { ok, error } = await connection.request({ do: "hand", action });
    this.#answer = ok ? (action === "ask" ? "asked" : "") : `refused: ${error}`;
    this.#show();
  }

  #actByKey() {
    const hand = this.#seat?.connection.state?.hand;
    if (hand === undefined) return;
    if (hand.you) void this.#act("give");
    else void this.#act(hand.holder === null ? "take" : "ask");
  }

  #handOver() {
    if (!this.#buttons.policy.hidden) void this.#act("policy");
  }

  #show() {
    const connection = this.#seat?.connection;
    const control = this.#control;
    if (connection === undefined || control === null) return;
    const { alive, hello, state, mayAct } = connection;
    const acts = alive && state !== null && mayAct;
    const usable = acts && hello?.joystick === "page";
    const hand = state?.hand ?? { holder: null, you: false, wanted_by: null, who: "", asks: "", policy: "" };
    this.#buttons.take.hidden = !usable || hand.holder !== null;
    // At another joystick a page ends the turn of a policy only.
    const ends = acts && hand.policy !== "" && hand.who === `the policy ${hand.policy}`;
    this.#buttons.ask.hidden = !(usable || ends) || hand.you || hand.holder === null;
    this.#buttons.give.hidden = !usable || !hand.you;
    this.#buttons.refuse.hidden = !usable || !hand.you || hand.wanted_by === null;
    this.#buttons.policy.hidden = !acts || hand.policy === "" || !(hand.you || hand.holder === null);
    const wanted = hand.you && hand.wanted_by !== null;
    setText(this.#buttons.give, wanted ? `Give it to ${hand.asks}` : ACTIONS.give);
    this.#buttons.give.classList.toggle("main", wanted);
    this.#showWords(control, hand);
    const steers = String(control.source !== null);
    if (this.dataset.steers !== steers) this.dataset.steers = steers;
  }

  /** Whether the robot follows what presses now. */
  #steering() {
    const connection = this.#seat?.connection;
    const situation = connection === undefined ? null : situationOf(connection);
    if (connection === undefined || situation === null) return "";
    if (situation.why === "functional test") return situation.reason;
    if (situation.why === "ready") return "keep it pressed";
    return follows(connection) ? "you steer" : `no motion: ${situation.reason}`;
  }

  /** What to do to move the robot. */
  #advice() {
    const connection = this.#seat?.connection;
    return connection === undefined ? "" : (situationOf(connection)?.advice ?? "");
  }

  /** @param {HandControl} control @param {StateText["hand"]} hand */
  #showWords(control, hand) {
    const hindrance = control.hindrance;
    let words = hand.you ? "you have it" : "free";
    if (hindrance !== "") words = hindrance;
    else if (control.source !== null) words = this.#steering();
    if (hand.you && hand.wanted_by !== null) words = `${hand.asks} asks for it`;
    if (words !== this.#words.textContent && hand.wanted_by !== null) announce(words);
    setText(this.#words, words);
    setText(this.#hint, control.refusal || this.#answer || (hindrance === "" ? this.#advice() : ""));
  }
}

customElements.define("hand-panel", HandPanel);

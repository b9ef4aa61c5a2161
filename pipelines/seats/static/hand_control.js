/**
 * The hand in the page: what presses and moves the handle, and when it must let go.
 *
 * Pointer, keys, game controller and headset press, move and release; one of them at a time. The
 * page lets go when it loses the focus, is hidden or left, when the server is lost, and when the
 * handle is another's.
 *
 * @import { Hand } from "./wire.js"
 */

/** While the handle is held the worker hears of it this often; it lets go after 100 ms. */
const HEARTBEAT_MS = 30;

/** More than the page's error about the session's clock. */
const CLOCK_ERROR_US = 20_000;

/**
 * What the hand needs of a connection: `Connection` has it, and the line of a study.
 * @typedef {object} HandLine
 * @property {boolean} alive
 * @property {boolean} mayAct
 * @property {string} hindrance
 * @property {{joystick: string, workspace: {half_width_m: number, half_height_m: number}} | null} hello
 * @property {{hand: {holder: number | null, you: boolean, who: string}, now_us: number, joystick?: {axes: {position: number, half_range: number}[]} | null} | null} state
 * @property {(name: any, listener: (event: any) => void) => unknown} on
 * @property {(request: {do: "hand", action: "take"}) => Promise<{ok: boolean, error: string}>} request
 * @property {(hand: Hand) => void} sendHand
 * @property {() => number | null} nowUs
 */

/** @typedef {"pointer" | "keys" | "controller" | "headset" | "axis"} Source */

/** Its events: `change` when what presses changes, `target` when the target moves or vanishes. */
export class HandControl extends EventTarget {
  #connection;
  /** What presses now. @type {Source | null} */
  #source = null;
  /** Whether the server was told of this press. */
  #steers = false;
  /** Since when, on the session's clock. */
  #sinceUs = 0;
  /** Where the handle is, -1 to 1, by the newest row of the joystick; null before the first. @type {{x: number, y: number} | null} */
  #handle = null;
  /** Where the hand wants it. */
  #target = { x: 0, y: 0 };
  #buttons = 0;
  /** Where it wants the axes behind x and y. @type {number[]} */
  #more = [];
  /** @type {ReturnType<typeof setInterval> | undefined} */
  #heartbeat;
  /** Why the last press was refused or ended, or "". */
  refusal = "";

  /** @param {HandLine} connection */
  constructor(connection) {
    super();
    this.#connection = connection;
    const letGo = () => this.releaseAll();
    addEventListener("blur", letGo);
    addEventListener("pagehide", letGo);
    document.addEventListener("visibilitychange", () => {
      if (document.hidden) letGo();
    });
    connection.on("lost", letGo);
    connection.on("let_go", () => {
      this.refusal = "let go, because this page was busy or the server silent: press anew";
      letGo();
    });
    connection.on("hello", letGo);
    connection.on("state", ({ hand, now_us }) => {
      // A state from before the handle was taken may arrive after it.
      if (this.#steers && !hand.you && now_us > this.#sinceUs) letGo();
    });
    connection.on("haptic", ({ end, rows, xM, yM }) => {
      const workspace = connection.hello?.workspace;
      if (end !== "joystick" || rows === 0 || workspace === undefined) return;
      this.#handle = {
        x: cut(/** @type {number} */ (xM[rows - 1]) / workspace.half_width_m),
        y: cut(/** @type {number} */ (yM[rows - 1]) / workspace.half_height_m),
      };
    });
  }

  /** What presses now, or null. */
  get source() {
    return this.#source;
  }

  /** Where the hand wants the handle, -1 to 1; null while nothing presses. */
  get target() {
    return this.#source === null ? null : this.#target;
  }

  /** Why the hand cannot steer now; "" if it can. */
  get hindrance() {
    const { alive, hello, state, mayAct } = this.#connection;
    if (!alive || hello === null || state === null) return this.#connection.hindrance || "the server does not answer";
    if (hello.joystick !== "page") return `the joystick "${hello.joystick}" steers`;
    if (!mayAct) return "a viewer may watch only";
    const { holder, you, who } = state.hand;
    return holder === null || you ? "" : `${who} has the handle: ask for it`;
  }

  /** Presses the dead-man button; a free handle is taken. Returns whether the press counts. @param {Source} source */
  press(source) {
    if (this.#source !== null) return this.#source === source;
    const why = this.hindrance;
    this.refusal = why === "" ? "" : `This press does not count: ${why.replace(/\.$/, "")}. Let go, and press anew.`;
    if (why === "") {
      this.#source = source;
      this.#target = { ...(this.#handle ?? { x: 0, y: 0 }) };
      const axes = this.#connection.state?.joystick?.axes ?? [];
      this.#more = axes.map(({ position, half_range }) => cut(position / half_range));
      if (this.#connection.state?.hand.you === true) this.#steer();
      else void this.#take(source);
    }
    this.#tell();
    return this.#source === source;
  }

  /** Moves the target, if this source presses. -1 to 1; what lies beyond is cut off. @param {Source} source @param {number} x @param {number} y */
  move(source, x, y) {
    if (this.#source !== source) return;
    this.#target = { x: cut(x), y: cut(y) };
    this.#send();
    this.dispatchEvent(new Event("target"));
  }

  /** Where the hand wants an axis behind x and y, or null while nothing presses. @param {number} axis */
  axisTarget(axis) {
    return this.#source === null ? null : (this.#more[axis] ?? null);
  }

  /** Moves an axis behind x and y, whatever presses. @param {number} axis @param {number} share -1 to 1 */
  moveAxis(axis, share) {
    if (this.#source === null || axis >= this.#more.length) return;
    this.#more[axis] = cut(share);
    this.#send();
    this.dispatchEvent(new Event("target"));
  }

  /** @param {number} buttons One bit a button. */
  setButtons(buttons) {
    if (buttons === this.#buttons) return;
    this.#buttons = buttons;
    this.#send();
  }

  /** @param {Source} source */
  release(source) {
    if (this.#source === source) this.releaseAll();
  }

  releaseAll() {
    if (this.#source === null) return;
    this.#source = null;
    this.#steers = false;
    clearInterval(this.#heartbeat);
    this.#connection.sendHand({ deadMan: false, x: 0, y: 0, buttons: 0 });
    this.#tell();
  }

  /** @param {Source} source */
  async #take(source) {
    const { ok, error } = await this.#connection.request({ do: "hand", action: "take" });
    if (this.#source !== source || this.#steers) return;
    if (ok) {
      this.#steer();
    } else {
      this.refusal = error;
      this.releaseAll();
    }
  }

  #steer() {
    this.#steers = true;
    this.#sinceUs = (this.#connection.nowUs() ?? 0) + CLOCK_ERROR_US;
    this.#send();
    this.#heartbeat = setInterval(() => this.#send(), HEARTBEAT_MS);
  }

  #send() {
    if (!this.#steers) return;
    /** @type {Hand} */
    const hand = { deadMan: true, ...this.#target, buttons: this.#buttons, more: this.#more };
    this.#connection.sendHand(hand);
  }

  #tell() {
    this.dispatchEvent(new Event("change"));
    this.dispatchEvent(new Event("target"));
  }
}

/** @param {number} value */
const cut = (value) => Math.max(-1, Math.min(1, value));

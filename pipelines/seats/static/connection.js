/**
 * The page's side of its seat worker: typed events, requests, and the session's clock.
 *
 * @import { AnswerText, ChatText, CommandsText, EventsText, ExercisesText, ExperimentText, FiguresText, HelloText, PanelText, RadioText, Request, RobotText, ServerText, StateText, StreamText, UpkeepText, ValuesText } from "./texts.js"
 * @import { FrameNote, PageNote, PreviewNote, WorkerNote } from "./worker_messages.js"
 * @import { Hand, Haptics } from "./wire.js"
 */
import { hindranceOf } from "./conditions.js";
import { pageMs } from "./page_clock.js";
import { readHaptics } from "./wire.js";

/** Without an answer for this long, a request counts as failed. */
const ANSWER_PATIENCE_MS = 10_000;
/** A telecommand is repeated until it is acknowledged. */
const COMMAND_PATIENCE_MS = 40_000;

/**
 * The events by name. A listener of `frame` or `preview` draws at once: the frame is closed when
 * all listeners have returned.
 * @typedef {object} Events
 * @property {HelloText} hello A connection began; everything before is void.
 * @property {StateText} state
 * @property {FiguresText} figures
 * @property {FrameNote & {of: StreamText}} frame
 * @property {Haptics} haptic
 * @property {PreviewNote} preview
 * @property {AnswerText} answer
 * @property {ChatText} chat
 * @property {CommandsText} commands
 * @property {ValuesText} values
 * @property {EventsText} events
 * @property {RadioText} radio
 * @property {PanelText} panel
 * @property {ExperimentText} experiment
 * @property {RobotText} robot
 * @property {ExercisesText} exercises
 * @property {UpkeepText} upkeep
 * @property {undefined} heard The server is heard again.
 * @property {{why: "closed" | "silent" | "refused", reason: string}} lost The server is not heard.
 * @property {{stream: string, why: string}} fault A decoder closed; a replay opens it anew.
 * @property {undefined} let_go The hand was released; it must press anew.
 */

export class Connection {
  /** @type {{[Name in keyof Events]?: Set<(event: Events[Name]) => void>}} */
  #listeners = {};
  /** @type {Map<number, (answer: AnswerText) => void>} */
  #pending = new Map();
  #number = 0;
  #worker;
  /** @type {number | null} */
  #offsetUs = null;
  /** @type {HelloText | null} */
  hello = null;
  /** @type {StateText | null} */
  state = null;
  /** What processes of this end show. @type {RobotText | null} */
  robot = null;
  /** @type {ExperimentText | null} */
  experiment = null;
  /** @type {PanelText | null} */
  panel = null;
  /** Whether the session was stopped at its page on the ground. */
  stopped = false;
  /** Whether the session of this address is over. */
  ended = false;
  /** Whether the server is heard. */
  alive = false;
  /** The least round trip of late, in ms. @type {number | null} */
  roundTripMs = null;

  constructor() {
    const plain = document.body.hasAttribute("data-plain") ? "?plain" : "";
    this.#worker = new Worker(new URL(`seat_worker.js${plain}`, import.meta.url), { type: "module" });
    this.#worker.onmessage = (event) => this.#handleNote(event.data);
    this.#worker.onerror = (event) => this.#handleLost("closed", event.message);
  }

  /**
   * Calls `listener` at each event of this name, until the function that is returned is called.
   * @template {keyof Events} Name
   * @param {Name} name @param {(event: Events[Name]) => void} listener
   */
  on(name, listener) {
    /** @type {Set<(event: Events[Name]) => void>} */
    const listeners = this.#listeners[name] ?? new Set();
    listeners.add(listener);
    /** @type {Record<string, unknown>} */ (this.#listeners)[name] = listeners;
    return () => {
      listeners.delete(listener);
    };
  }

  /** The instant now on the session's clock, in µs; null before the first connection. */
  nowUs() {
    return this.#offsetUs === null ? null : 1000 * pageMs() + this.#offsetUs;
  }

  /** Why nothing passes between the seats; "" if nothing is known to prevent it. */
  get hindrance() {
    return hindranceOf(this);
  }

  /** Whether this page may act, or only watch. */
  get mayAct() {
    return this.hello !== null && this.hello.role !== "viewer";
  }

  /**
   * Asks the server for something. The answer always comes, at the latest after 10 s; that of a
   * telecommand after 40 s.
   * @param {Request} request @returns {Promise<AnswerText>}
   */
  request(request) {
    this.#number += 1;
    const number = this.#number;
    if (!this.alive) return Promise.resolve(refusal(number, "the server does not answer"));
    return new Promise((resolve) => {
      this.#pending.set(number, resolve);
      this.#tell({ kind: "request", text: JSON.stringify({ request: number, ...request }) });
      const patienceMs = request.do === "command" ? COMMAND_PATIENCE_MS : ANSWER_PATIENCE_MS;
      const words = `no answer within ${patienceMs / 1000} s`;
      setTimeout(() => this.#settle(refusal(number, words)), patienceMs);
    });
  }

  /**
   * When the picture was captured by which the person steers, as the page has painted it; 0 if it
   * has painted none yet, -1 if it shows none.
   */
  paintedUs = -1;

  /** Says what the hand does; while it is held, at least every 100 ms. @param {Hand} hand */
  sendHand(hand) {
    this.#tell({ kind: "hand", hand, pictureUs: this.paintedUs });
  }

  /** From now on the blocks of this voice go to `port`. @param {string} stream @param {MessagePort} port */
  attachSound(stream, port) {
    this.#tell({ kind: "sound_port", stream, port }, [port]);
  }

  /** @param {PageNote} note @param {Transferable[]} [transfer] */
  #tell(note, transfer = []) {
    this.#worker.postMessage(note, transfer);
  }

  /** @param {WorkerNote} note */
  #handleNote(note) {
    switch (note.kind) {
      case "text":
        this.#handleText(note.text);
        break;
      case "frame": {
        const of = this.hello?.streams.find((stream) => stream.index === note.stream);
        if (of !== undefined) this.#emit("frame", { ...note, of });
        note.frame.close();
        this.#tell({ kind: "drawn", stream: note.stream });
        break;
      }
      case "preview":
        this.#emit("preview", note);
        note.frame.close();
        break;
      case "haptic":
        this.#emit("haptic", readHaptics(note.message));
        break;
      case "clock":
        this.#offsetUs = note.offsetUs;
        this.roundTripMs = note.roundTripMs;
        break;
      case "heard":
        this.alive = true;
        this.#emit("heard", undefined);
        break;
      case "lost":
        this.#handleLost(note.why, note.reason);
        break;
      case "fault": {
        const stream = this.hello?.streams.find((one) => one.index === note.stream)?.name ?? "";
        this.#emit("fault", { stream, why: note.why });
        break;
      }
      case "let_go":
        this.#emit("let_go", undefined);
        break;
    }
  }

  /** @param {ServerText} text */
  #handleText(text) {
    switch (text.kind) {
      case "hello":
        this.hello = text;
        this.robot = this.experiment = this.panel = null;
        // Late by the way here; the first ping mends it.
        this.#offsetUs = text.now_us - 1000 * pageMs();
        this.#emit("hello", text);
        break;
      case "state":
        this.state = text;
        this.#emit("state", text);
        break;
      case "figures":
        this.stopped = text.state === "stopped";
        this.#emit("figures", text);
        break;
      case "answer":
        this.#settle(text);
        this.#emit("answer", text);
        break;
      case "chat":
        this.#emit("chat", text);
        break;
      case "commands":
        this.#emit("commands", text);
        break;
      case "values":
        this.#emit("values", text);
        break;
      case "events":
        this.#emit("events", text);
        break;
      case "radio":
        this.#emit("radio", text);
        break;
      case "panel":
        this.panel = text;
        this.#emit("panel", text);
        break;
      case "experiment":
        this.experiment = text;
        this.#emit("experiment", text);
        break;
      case "robot":
        this.robot = text;
        this.#emit("robot", text);
        break;
      case "exercises":
        this.#emit("exercises", text);
        break;
      case "upkeep":
        this.#emit("upkeep", text);
        break;
    }
  }

  /** @param {"closed" | "silent" | "refused"} why @param {string} reason */
  #handleLost(why, reason) {
    this.alive = false;
    this.ended = this.ended || why === "refused";
    if (why === "closed") {
      for (const number of [...this.#pending.keys()]) {
        this.#settle(refusal(number, "the connection was lost"));
      }
    }
    this.#emit("lost", { why, reason });
  }

  /** @param {AnswerText} answer */
  #settle(answer) {
    this.#pending.get(answer.request)?.(answer);
    this.#pending.delete(answer.request);
  }

  /** @template {keyof Events} Name @param {Name} name @param {Events[Name]} event */
  #emit(name, event) {
    for (const listener of this.#listeners[name] ?? []) listener(event);
  }
}

/** @param {number} request @param {string} error @returns {AnswerText} */
const refusal = (request, error) => ({ kind: "answer", request, ok: false, error });

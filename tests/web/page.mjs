/**
 * What a browser gives to the modules of the pages: a clock, timers, events, sockets, workers and
 * canvases, all of which stand still until a test moves them. Import it before `load`.
 */
import { setMaxListeners } from "node:events";

/** The newest of what the modules have made. */
export const made = { socket: null, worker: null, sockets: [] };
/** What a worker or worklet has told. */
export const told = [];
/** Answers of the server to `fetch`, by method; and what was fetched. */
export const answers = {};
export const fetched = [];

let nowMs = 0;
let number = 0;
const timers = new Map();
const plan = (act, ms, everyMs) => {
  timers.set((number += 1), { act, atMs: nowMs + Math.max(ms ?? 0, 1), everyMs });
  return number;
};

/** Lets time pass: what is due happens in its order. */
export function pass(ms) {
  const endMs = nowMs + ms;
  for (;;) {
    const due = [...timers].filter(([, one]) => one.atMs <= endMs).sort(([, a], [, b]) => a.atMs - b.atMs)[0];
    if (due === undefined) break;
    const [key, timer] = due;
    nowMs = timer.atMs;
    if (timer.everyMs === undefined) timers.delete(key);
    else timer.atMs += timer.everyMs;
    timer.act();
  }
  nowMs = endMs;
}

/** Lets all promises be kept that wait for no time. */
export async function settle() {
  for (let turn = 0; turn < 20; turn += 1) await new Promise(setImmediate);
}

/** The time, as modules see it. */
export const clockMs = () => nowMs;

class Socket {
  static OPEN = 1;
  readyState = 0;
  bufferedAmount = 0;
  sent = [];
  constructor(url) {
    this.url = String(url);
    made.socket = this;
    made.sockets.push(this);
  }
  send(message) {
    this.sent.push(message);
  }
  close(code = 1000, reason = "") {
    if (this.readyState === 3) return;
    this.readyState = 3;
    this.onclose?.({ code, reason });
  }
  /** The server lets it in. */
  open() {
    this.readyState = 1;
    this.onopen?.();
  }
  /** The server says this. */
  hear(data) {
    this.onmessage?.({ data: typeof data === "object" && !(data instanceof ArrayBuffer) ? JSON.stringify(data) : data });
  }
}

class PageWorker {
  told = [];
  constructor(url) {
    this.url = String(url);
    made.worker = this;
  }
  postMessage(note) {
    this.told.push(note);
  }
  terminate() {
    this.ended = true;
  }
  /** The worker tells this. */
  tell(data) {
    this.onmessage({ data });
  }
}

/** A context that keeps the names of what is called, with their numbers. */
export class Drawn {
  calls = [];
  constructor() {
    const proxy = new Proxy(this, {
      get: (self, name) => (name in self ? self[name] : (...words) => self.calls.push([name, ...words])),
      set: (self, name, value) => {
        self.calls.push(["set", name, value]);
        return true;
      },
    });
    return proxy;
  }
  /** The numbers of each call of this name. */
  of(name) {
    return this.calls.filter(([one]) => one === name).map(([, ...words]) => words);
  }
}

export class Element extends EventTarget {
  attributes = {};
  style = {};
  dataset = {};
  textContent = "";
  clientWidth = 0;
  clientHeight = 0;
  context = new Drawn();
  constructor(attributes = {}) {
    super();
    this.attributes = attributes;
  }
  getContext() {
    return this.context;
  }
  getAttribute(name) {
    return this.attributes[name] ?? null;
  }
  hasAttribute(name) {
    return name in this.attributes;
  }
  append() {}
  closest(selectors) {
    return selectors.split(", ").includes(this.attributes.of) ? this : null;
  }
}

/** Observers of sizes and of what can be seen, by element: `look(element, ...)` calls them. */
const watched = new Map();
export const look = (element, entry = {}) => watched.get(element)([{ target: element, ...entry }]);
class Observer {
  constructor(act) {
    this.act = act;
  }
  observe(element) {
    watched.set(element, this.act);
  }
}

const page = new EventTarget();
setMaxListeners(0, page);
export const body = Object.assign(new Element(), { plain: false });
body.hasAttribute = (name) => name === "data-plain" && body.plain;
export const paper = Object.assign(new EventTarget(), {
  hidden: false,
  focused: true,
  hasFocus: () => paper.focused,
  baseURI: "https://host/token/static/page.html",
  body,
  documentElement: { dataset: {} },
  createElement: () => new Element(),
  /** What is found by any selector. */
  found: [],
  querySelector: () => null,
  querySelectorAll: () => paper.found,
});
setMaxListeners(0, paper);
/** The game controllers, and the devices. */
export const hardware = { pads: [], devices: undefined, tracks: [] };

/** An event with these fields, also with those that an `Event` has itself. */
export function event(name, fields = {}, kind = Event) {
  const one = new kind(name);
  for (const [field, value] of Object.entries(fields)) Object.defineProperty(one, field, { value });
  return one;
}
/** Something happens to the window. */
export const happen = (name, fields, kind) => page.dispatchEvent(event(name, fields, kind));

const globals = {
  performance: { timeOrigin: 0, now: () => nowMs },
  setTimeout: (act, ms) => plan(act, ms),
  setInterval: (act, ms) => plan(act, ms, ms),
  clearTimeout: (one) => timers.delete(one),
  clearInterval: (one) => timers.delete(one),
  requestAnimationFrame: (act) => plan(act, 1),
  addEventListener: page.addEventListener.bind(page),
  navigator: { getGamepads: () => hardware.pads, get mediaDevices() { return hardware.devices; } },
  document: paper,
  Element,
  HTMLElement: Element,
  PointerEvent: class extends Event {},
  CustomEvent: class extends Event {
    constructor(name, { detail }) {
      super(name);
      this.detail = detail;
    }
  },
  WebSocket: Socket,
  Worker: PageWorker,
  ResizeObserver: Observer,
  IntersectionObserver: Observer,
  devicePixelRatio: 2,
  getComputedStyle: ({ style }) => ({ color: style.color }),
  matchMedia: () => ({ matches: false, addEventListener: () => undefined }),
  sessionStorage: { getItem: () => null, setItem: () => undefined },
  self: { location: { search: "" }, postMessage: (note) => told.push(note) },
  fetch: async (url, { method = "GET", ...more } = {}) => {
    fetched.push({ url: String(url), method, ...more });
    const answer = answers[method]?.({ url, ...more });
    if (answer === undefined) throw new Error("nobody answers");
    return { status: 200, ok: true, headers: new Headers(answer.headers ?? {}), text: async () => answer.text ?? "", ...answer.of };
  },
  VideoFrame: class {
    constructor(data, fields) {
      Object.assign(this, { data }, fields);
    }
    close() {
      this.closed = true;
    }
  },
  EncodedVideoChunk: class {
    constructor(fields) {
      Object.assign(this, fields);
    }
  },
};
for (const [name, value] of Object.entries(globals)) {
  Object.defineProperty(globalThis, name, { value, configurable: true, writable: true });
}

/** A connection of a page that only tells, and keeps what it is told. */
export class Line {
  alive = true;
  mayAct = true;
  hindrance = "";
  hello = { joystick: "page", workspace: { half_width_m: 0.1, half_height_m: 0.05 } };
  state = { now_us: 0, hand: { holder: null, you: false, who: "" }, joystick: { axes: [] } };
  hands = [];
  asked = [];
  answer = { ok: true, error: "" };
  #listeners = {};
  on(name, listener) {
    (this.#listeners[name] ??= []).push(listener);
  }
  tell(name, event) {
    for (const listener of this.#listeners[name] ?? []) listener(event);
  }
  async request(request) {
    this.asked.push(request);
    return this.answer;
  }
  sendHand(hand) {
    this.hands.push(hand);
  }
  nowUs() {
    return 1000 * nowMs;
  }
}

/** A message of haptics with one row. */
export const haptics = (end, xM, yM, forceXN = 0, forceYN = 0, flags = 0) => ({
  end,
  rows: 1,
  xM: [xM],
  yM: [yM],
  forceXN: [forceXN],
  forceYN: [forceYN],
  flags: [flags],
});

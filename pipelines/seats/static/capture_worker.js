/**
 * Sends the page's own camera or microphone while its button is on, through a socket of its own.
 *
 * With the end of this worker the socket closes, and the input falls back to what it was.
 *
 * @import { CaptureNote, CaptureOrder } from "./capture_messages.js"
 * @import { BlockNote } from "./sound_messages.js"
 * @import { InputText } from "./texts.js"
 */
import { BlockClock } from "./block_clock.js";
import { pingIntervalMs } from "./clock_offset.js";
import { FrameConverter } from "./i420.js";
import { pageMs } from "./page_clock.js";
import { ownPicture, writeOwnSound, writePing } from "./wire.js";

const RECONNECT_MS = 250;
const WATCH_MS = 50;
/** Why a connection ends of which another one may do better (RFC 6455, 7.4.1). */
const TRY_AGAIN = new Set([1000, 1001, 1005, 1006, 1011, 1012, 1013]);
/** Waiting sound beyond 100 ms is dropped: it would only be late. */
const MOST_SOUND_OCTETS = 5 * 2000;
/** Frames may come a little early, but not at twice the rate. */
const EARLY = 0.7;

/** @param {CaptureNote} note */
const tell = (note) => self.postMessage(note);

function address() {
  const url = new URL("../media", import.meta.url);
  url.protocol = url.protocol === "https:" ? "wss:" : "ws:";
  return url;
}

class CaptureSocket {
  /** @type {WebSocket | null} */
  #socket = null;
  #openedMs = 0;
  #pingedMs = 0;
  #name;
  /** Whether the server gave the input to this page. */
  taken = false;

  /** @param {string} name The input's. */
  constructor(name) {
    this.#name = name;
    this.#connect();
    setInterval(() => this.#watch(), WATCH_MS);
  }

  /** Octets that wait in the socket. */
  get waiting() {
    return this.#socket?.bufferedAmount ?? 0;
  }

  /** @param {ArrayBuffer} message */
  send(message) {
    if (this.taken && this.#socket?.readyState === WebSocket.OPEN) this.#socket.send(message);
  }

  #connect() {
    const socket = new WebSocket(address());
    socket.binaryType = "arraybuffer";
    this.#socket = socket;
    socket.onopen = () => {
      this.#openedMs = pageMs();
      this.#ping();
      socket.send(JSON.stringify({ request: 1, do: "input", name: this.#name, on: true }));
    };
    socket.onmessage = (event) => {
      if (typeof event.data === "string") this.#handleAnswer(JSON.parse(event.data));
    };
    socket.onclose = (event) => {
      this.taken = false;
      if (!TRY_AGAIN.has(event.code)) {
        this.#stop(event.reason || `the server closed the connection (${event.code})`);
      } else if (this.#socket === socket) {
        tell({ kind: "lost" });
        setTimeout(() => this.#connect(), RECONNECT_MS);
      }
    };
  }

  /** @param {{kind: string, ok?: boolean, error?: string}} answer */
  #handleAnswer({ kind, ok, error }) {
    if (kind !== "answer") return;
    if (ok === true) {
      this.taken = true;
      tell({ kind: "taken" });
    } else {
      this.#stop(error ?? "refused");
    }
  }

  /** @param {string} why */
  #stop(why) {
    const socket = this.#socket;
    this.#socket = null;
    this.taken = false;
    socket?.close();
    tell({ kind: "refused", why });
  }

  #watch() {
    if (this.#socket?.readyState !== WebSocket.OPEN) return;
    if (pageMs() - this.#pingedMs >= pingIntervalMs(pageMs() - this.#openedMs)) this.#ping();
  }

  #ping() {
    this.#pingedMs = pageMs();
    this.#socket?.send(writePing(this.#pingedMs));
  }
}

/** @param {InputText} input @param {ReadableStream<VideoFrame>} frames */
async function sendPictures(input, frames) {
  const [width, height] = [input.width ?? 640, input.height ?? 480];
  const intervalMs = 1000 / (input.fps ?? 30);
  const converter = new FrameConverter(width, height);
  const socket = new CaptureSocket(input.name);
  let sentMs = -Infinity;
  const reader = frames.getReader();
  for (;;) {
    const { value: frame, done } = await reader.read();
    if (done) return;
    const nowMs = pageMs();
    // A picture that would wait behind another one is dropped here.
    if (socket.taken && socket.waiting === 0 && nowMs - sentMs >= EARLY * intervalMs) {
      sentMs = nowMs;
      const { message, i420 } = ownPicture(input.index, width, height, nowMs);
      await converter.fill(frame, i420);
      socket.send(message);
    }
    frame.close();
  }
}

/** @param {InputText} input @param {MessagePort} port */
function sendSound(input, port) {
  const socket = new CaptureSocket(input.name);
  const clock = new BlockClock();
  let number = 0;
  port.onmessage = (/** @type {MessageEvent<BlockNote>} */ event) => {
    const { samples, firstMs } = event.data;
    const firstPageMs = clock.handleBlock(firstMs, samples.length / 48, pageMs());
    number += 1;
    if (socket.waiting > MOST_SOUND_OCTETS) return;
    socket.send(writeOwnSound(input.index, number, firstPageMs, samples));
  };
}

self.onmessage = (/** @type {MessageEvent<CaptureOrder>} */ event) => {
  const order = event.data;
  if (order.kind === "sound") sendSound(order.input, order.port);
  else sendPictures(order.input, order.frames).catch((error) => tell({ kind: "refused", why: String(error) }));
};

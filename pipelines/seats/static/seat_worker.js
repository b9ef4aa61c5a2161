/**
 * The seat's connection: the WebSocket, the clock, the decoders, and the sending of the hand.
 *
 * It is a worker, so that a busy page neither delays a picture's decoding nor the hand.
 *
 * @import { PageNote, WorkerNote } from "./worker_messages.js"
 * @import { ServerText, StreamText } from "./texts.js"
 * @import { Decoded } from "./stream_decoder.js"
 */
import { ClockOffset, pingIntervalMs } from "./clock_offset.js";
import { HandSender } from "./hand_sender.js";
import { pageMs } from "./page_clock.js";
import { Silence } from "./silence.js";
import { StreamDecoder } from "./stream_decoder.js";
import {
  Kind,
  kindOf,
  readPong,
  readPreview,
  readSound,
  readUnit,
  writeHand,
  writePing,
} from "./wire.js";

const RECONNECT_MS = 250;
/** The status of a page whose token is not of the session that runs. */
const REFUSED = 403;
/** The server tells the state every 100 ms; after this silence it counts as gone. */
const SILENCE_MS = 250;
const WATCH_MS = 25;
const HAND_MS = 4;
/** Wait this long for a replay after a decoder's fault, then connect anew, which brings one. */
const REPLAY_PATIENCE_MS = 1500;
/** More octets than this in the socket mean that nothing is sent; the hand must not queue. */
const MOST_UNSENT_OCTETS = 4096;

/** @param {WorkerNote} note @param {Transferable[]} [transfer] */
const tell = (note, transfer = []) => self.postMessage(note, { transfer });

/** The socket's address: `ws` beside `static/`, so that it carries the token. */
function address() {
  const url = new URL("../ws", import.meta.url);
  // A page without pictures asks for none.
  url.search = self.location.search;
  url.protocol = url.protocol === "https:" ? "wss:" : "ws:";
  return url;
}

/** One stream's decoder, and the newest picture while the page draws an older one. */
class Screen {
  /** @type {Decoded | null} */
  #newest = null;
  #drawing = false;
  #index;
  #decoder;
  /** Since when a replay is awaited; null if none is. @type {number | null} */
  faultMs = null;

  /** @param {number} index */
  constructor(index) {
    this.#index = index;
    this.#decoder = new StreamDecoder(
      (picture) => this.#handlePicture(picture),
      (why) => {
        this.faultMs = pageMs();
        tell({ kind: "fault", stream: index, why });
      },
    );
  }

  /** @param {ArrayBuffer} message */
  handleMessage(message) {
    this.#decoder.handleUnit(readUnit(message));
    if (!this.#decoder.waiting) this.faultMs = null;
  }

  handleDrawn() {
    this.#drawing = false;
    if (this.#newest !== null) this.#show(this.#newest);
  }

  close() {
    this.#decoder.close();
    this.#newest?.frame.close();
    this.#newest = null;
  }

  /** @param {Decoded} picture */
  #handlePicture(picture) {
    if (this.#drawing) {
      this.#newest?.frame.close();
      this.#newest = picture;
    } else {
      this.#show(picture);
    }
  }

  /** @param {Decoded} picture */
  #show(picture) {
    this.#drawing = true;
    this.#newest = null;
    tell({ kind: "frame", stream: this.#index, receivedMs: pageMs(), ...picture }, [picture.frame]);
  }
}

/** One connection after the other. */
class Seat {
  /** @type {WebSocket | null} */
  #socket = null;
  #openedMs = 0;
  /** Whether the session of this page's token is over. */
  #ended = false;
  #silence = new Silence();
  #pingedMs = 0;
  #silent = true;
  #clock = new ClockOffset();
  /** @type {Map<number, Screen>} */
  #screens = new Map();
  /** @type {StreamText[]} */
  #streams = [];
  /** By the name of a stream. @type {Map<string, MessagePort>} */
  #soundPorts = new Map();
  #hand = new HandSender();
  #handNumber = 0;
  #pictureUs = -1;
  /** @type {ReturnType<typeof setInterval> | undefined} */
  #handTimer;

  connect() {
    const socket = new WebSocket(address());
    socket.binaryType = "arraybuffer";
    this.#socket = socket;
    let opened = false;
    socket.onopen = () => {
      opened = true;
      this.#openedMs = pageMs();
      this.#silence.handleHeard();
      this.#clock = new ClockOffset();
      this.#ping();
    };
    socket.onmessage = (event) => this.#handleMessage(event.data);
    socket.onclose = (event) => {
      this.#handleClosed(socket, event.reason);
      if (!opened) void this.#askWhether();
    };
  }

  /** A browser does not say why a socket was refused; a file with the same token does. */
  async #askWhether() {
    const { status } = await fetch(new URL("icon.svg", import.meta.url), { cache: "no-store" }).catch(() => ({ status: 0 }));
    if (status !== REFUSED) return;
    // A token never becomes valid again.
    this.#ended = true;
    this.#socket?.close();
    this.#lose("refused", "");
  }

  /** @param {PageNote} note */
  handleNote(note) {
    switch (note.kind) {
      case "request":
        if (this.#socket?.readyState === WebSocket.OPEN) this.#socket.send(note.text);
        break;
      case "drawn":
        this.#screens.get(note.stream)?.handleDrawn();
        break;
      case "sound_port":
        this.#soundPorts.set(note.stream, note.port);
        break;
      case "hand":
        this.#pictureUs = note.pictureUs;
        this.#hand.handleHand(note.hand, pageMs());
        this.#sendHand();
        break;
    }
  }

  /** Looks whether the server is silent, whether to ping, and whether a replay did not come. */
  watch() {
    const nowMs = pageMs();
    const silentMs = this.#silence.look(nowMs);
    if (this.#socket?.readyState !== WebSocket.OPEN) return;
    if (!this.#silent && silentMs > SILENCE_MS) this.#lose("silent", "");
    if (nowMs - this.#pingedMs >= pingIntervalMs(nowMs - this.#openedMs)) this.#ping();
    for (const screen of this.#screens.values()) {
      if (screen.faultMs !== null && nowMs - screen.faultMs > REPLAY_PATIENCE_MS) {
        this.#socket.close();
        return;
      }
    }
  }

  /** @param {string | ArrayBuffer} message */
  #handleMessage(message) {
    this.#silence.handleHeard();
    if (this.#silent) {
      this.#silent = false;
      tell({ kind: "heard" });
    }
    if (typeof message === "string") this.#handleText(JSON.parse(message));
    else this.#handleBinary(message);
  }

  /** @param {ServerText} text */
  #handleText(text) {
    if (text.kind === "hello") {
      this.#closeScreens();
      this.#streams = text.streams;
      for (const stream of text.streams) {
        if (stream.kind === "video") this.#screens.set(stream.index, new Screen(stream.index));
      }
    }
    tell({ kind: "text", text });
  }

  /** @param {ArrayBuffer} message */
  #handleBinary(message) {
    switch (kindOf(message)) {
      case Kind.UNIT:
        this.#screens.get(new Uint8Array(message, 1, 1)[0] ?? -1)?.handleMessage(message);
        break;
      case Kind.SOUND:
        this.#handleSound(message);
        break;
      case Kind.HAPTIC:
        tell({ kind: "haptic", message }, [message]);
        break;
      case Kind.PREVIEW:
        this.#handlePreview(message);
        break;
      case Kind.PONG: {
        const pong = readPong(message);
        this.#clock.handleAnswer(pong.pageMs, pong.nowUs, pageMs());
        const best = this.#clock.best;
        if (best !== null) tell({ kind: "clock", ...best });
        break;
      }
    }
  }

  /** @param {ArrayBuffer} message */
  #handleSound(message) {
    const { stream, samples, captureUs, concealed } = readSound(message);
    const name = this.#streams.find((one) => one.index === stream)?.name ?? "";
    this.#soundPorts.get(name)?.postMessage({ samples, captureUs, concealed }, [message]);
  }

  /** @param {ArrayBuffer} message */
  #handlePreview(message) {
    const { preview, width, height, captureUs, i420 } = readPreview(message);
    const frame = new VideoFrame(i420, {
      format: "I420",
      codedWidth: width,
      codedHeight: height,
      timestamp: 0,
      colorSpace: { matrix: "smpte170m", primaries: "smpte170m", transfer: "smpte170m", fullRange: false },
    });
    tell({ kind: "preview", preview, frame, captureUs }, [frame]);
  }

  #ping() {
    this.#pingedMs = pageMs();
    this.#socket?.send(writePing(this.#pingedMs));
  }

  #sendHand() {
    const wasHeld = this.#hand.active;
    const hand = this.#hand.pollTransmit(pageMs());
    if (hand !== null) {
      const socket = this.#socket;
      // A late position is worthless; the release goes out whatever waits.
      if (
        socket?.readyState === WebSocket.OPEN &&
        (!hand.deadMan || socket.bufferedAmount < MOST_UNSENT_OCTETS)
      ) {
        this.#handNumber += 1;
        socket.send(writeHand(hand, this.#handNumber, this.#pictureUs));
      }
    }
    if (wasHeld && this.#hand.pressAnew) tell({ kind: "let_go" });
    if (this.#hand.active) {
      this.#handTimer ??= setInterval(() => this.#sendHand(), HAND_MS);
    } else {
      clearInterval(this.#handTimer);
      this.#handTimer = undefined;
    }
  }

  /** @param {"closed" | "silent" | "refused"} why @param {string} reason */
  #lose(why, reason) {
    this.#silent = true;
    // A silent server may still hear, so it is told of the release.
    this.#hand.handleLost();
    this.#sendHand();
    tell({ kind: "lost", why, reason });
  }

  /** @param {WebSocket} socket @param {string} reason */
  #handleClosed(socket, reason) {
    if (socket !== this.#socket) return;
    this.#socket = null;
    this.#closeScreens();
    this.#lose("closed", reason);
    setTimeout(() => {
      if (!this.#ended) this.connect();
    }, RECONNECT_MS);
  }

  #closeScreens() {
    for (const screen of this.#screens.values()) screen.close();
    this.#screens.clear();
  }
}

const seat = new Seat();
self.onmessage = (/** @type {MessageEvent<PageNote>} */ event) => seat.handleNote(event.data);
setInterval(() => seat.watch(), WATCH_MS);
seat.connect();

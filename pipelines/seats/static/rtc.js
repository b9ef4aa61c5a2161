/** The page of a partner across the Internet: it sees, hears, is seen and is heard. */
import { make, one, setText } from "./dom.js";
import { startTheme } from "./theme.js";
import { WhipExchange } from "./whip_exchange.js";

const token = new URLSearchParams(location.search).get("token") ?? "";
const names = (document.body.dataset.programmes ?? "").split(" ").filter((name) => name !== "");
const WORDS = new Map([
  ["main", "Picture and voice"],
  ["uplink", "From the robot's site"],
  ["downlink", "From space"],
]);
const LOOK_MS = 1000;

/** Puts H.264 first: no other picture is sent or taken. @param {RTCRtpTransceiver} transceiver */
function preferH264(transceiver) {
  const known = RTCRtpReceiver.getCapabilities("video")?.codecs ?? [];
  const wanted = known.filter((codec) => codec.mimeType === "video/H264");
  if (wanted.length > 0) transceiver.setCodecPreferences(wanted);
}

/** Rows of figures of a connection. @param {HTMLElement} list @param {[string, string][]} rows */
function show(list, rows) {
  while (list.children.length > 2 * rows.length) list.lastElementChild?.remove();
  rows.forEach(([name, value], row) => {
    const term = list.children[2 * row] ?? list.appendChild(document.createElement("dt"));
    const text = list.children[2 * row + 1] ?? list.appendChild(document.createElement("dd"));
    setText(term, name);
    setText(text, value);
  });
}

/** @param {HTMLElement} label @param {WhipExchange | null} exchange */
function showState(label, exchange) {
  const state = exchange === null ? "off" : exchange.fault !== "" ? exchange.fault : (exchange.peer?.connectionState ?? "connecting");
  setText(label, state);
  label.dataset.level = state === "connected" ? "good" : exchange !== null && exchange.fault !== "" ? "bad" : "warn";
}

/** @param {WhipExchange | null} exchange @param {Map<string, number>} before Counters of the last look. */
async function figures(exchange, before) {
  /** @type {[string, string][]} */
  const rows = [];
  const peer = exchange?.peer ?? null;
  if (peer === null) return rows;
  /** @param {string} name @param {number} value */
  const since = (name, value) => {
    const passed = value - (before.get(name) ?? value);
    before.set(name, value);
    return passed;
  };
  for (const row of (await peer.getStats()).values()) {
    if (row.type === "candidate-pair" && row.nominated && row.currentRoundTripTime !== undefined) {
      rows.push(["round trip", `${(row.currentRoundTripTime * 1000).toFixed(0)} ms`]);
    } else if (row.type === "inbound-rtp" || row.type === "outbound-rtp") {
      const octets = row.bytesReceived ?? row.bytesSent ?? 0;
      const kind = row.kind === "video" ? "picture" : "voice";
      rows.push([kind, `${((since(row.id, octets) * 8) / LOOK_MS).toFixed(0)} kbit/s`]);
      if (row.kind === "video" && row.framesPerSecond !== undefined) rows.push(["pictures", `${row.framesPerSecond} /s`]);
      if (row.packetsLost !== undefined) rows.push([`${kind} lost`, String(row.packetsLost)]);
    }
  }
  return rows;
}

/** Repeats a look once a second. @param {() => Promise<void>} look */
function everySecond(look) {
  setInterval(() => void look().catch(() => undefined), LOOK_MS);
}

// What is watched

/** @type {HTMLVideoElement[]} */
const pictures = [];

/** @param {string} name */
function watch(name) {
  const video = make("video", { playsinline: true, autoplay: true, "aria-label": WORDS.get(name) ?? name, "data-programme": name });
  video.muted = true;
  const state = make("span", { class: "small", "data-level": "warn" });
  const values = make("dl", { class: "values" });
  const title = make("h2", {}, WORDS.get(name) ?? name);
  one("#watched", HTMLElement).append(make("section", { class: "panel" }, make("header", {}, title, state), video, values));
  pictures.push(video);
  const stream = new MediaStream();
  video.srcObject = stream;
  const exchange = new WhipExchange(`/whep/${name}`, token, (peer) => {
    for (const track of stream.getTracks()) stream.removeTrack(track);
    preferH264(peer.addTransceiver("video", { direction: "recvonly" }));
    peer.addTransceiver("audio", { direction: "recvonly" });
    peer.addEventListener("track", (event) => {
      // The sender asks for no delay; older browsers do not heed that.
      if ("jitterBufferTarget" in event.receiver && event.track.kind === "video") event.receiver.jitterBufferTarget = 0;
      stream.addTrack(event.track);
      void video.play().catch(() => undefined);
    });
  });
  exchange.addEventListener("change", () => showState(state, exchange));
  const before = new Map();
  everySecond(async () => {
    showState(state, exchange);
    show(values, await figures(exchange, before));
  });
}

// Before, a video without a picture would keep the page loading.
addEventListener("load", () => names.forEach(watch));

const sound = one("#sound", HTMLButtonElement);
sound.addEventListener("click", () => {
  const on = sound.getAttribute("aria-pressed") !== "true";
  sound.setAttribute("aria-pressed", String(on));
  for (const video of pictures) video.muted = !on;
});

// What is sent

const own = one("#own", HTMLElement);
own.hidden = document.body.dataset.takes !== "true";
const send = one("#send", HTMLButtonElement);
const mute = one("#mute", HTMLButtonElement);
const ownPicture = one("#own-picture", HTMLVideoElement);
/** @type {WhipExchange | null} */
let sending = null;
/** @type {MediaStream | null} */
let media = null;

async function begin() {
  media = await navigator.mediaDevices.getUserMedia({
    video: { width: 640, height: 480, frameRate: 30 },
    audio: { echoCancellation: true },
  });
  ownPicture.srcObject = media;
  const taken = media;
  sending = new WhipExchange("/whip", token, (peer) => {
    for (const track of taken.getTracks()) {
      const transceiver = peer.addTransceiver(track, { direction: "sendonly", streams: [taken] });
      if (track.kind === "video") preferH264(transceiver);
    }
  });
}

function end() {
  sending?.close();
  sending = null;
  for (const track of media?.getTracks() ?? []) track.stop();
  media = null;
  ownPicture.srcObject = null;
}

send.addEventListener("click", async () => {
  setText(one("#own-fault", HTMLElement), "");
  send.disabled = true;
  try {
    if (sending === null) await begin();
    else end();
  } catch (error) {
    end();
    setText(one("#own-fault", HTMLElement), String(error instanceof Error ? error.message : error));
  }
  send.disabled = false;
  mute.disabled = sending === null;
  mute.setAttribute("aria-pressed", "false");
  setText(send, sending === null ? "Send camera and microphone" : "Stop");
});

mute.addEventListener("click", () => {
  const muted = mute.getAttribute("aria-pressed") !== "true";
  mute.setAttribute("aria-pressed", String(muted));
  for (const track of media?.getAudioTracks() ?? []) track.enabled = !muted;
});

const ownBefore = new Map();
everySecond(async () => {
  showState(one("#own-state", HTMLElement), sending);
  show(one("#own-values", HTMLElement), await figures(sending, ownBefore));
});

startTheme();

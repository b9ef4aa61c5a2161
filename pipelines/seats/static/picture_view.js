/**
 * `<picture-view stream="uplink_video" via="coded" figure="uplink_video.age_ms">` around a canvas:
 * one stream's newest picture, its age, and an unmistakable mark when it is stale. With `owner`, its
 * picture does not come by the radio, and nothing is announced.
 *
 * The age is by the page's own clock, so that it grows when the server is dead, too.
 *
 * @import { Events } from "./connection.js"
 * @import { Seat } from "./seat.js"
 */
import { announce } from "./announcer.js";
import { make, setText } from "./dom.js";
import { pageMs } from "./page_clock.js";

const TICK_MS = 100;
/** For a stream that does not say from which age on it is stale. */
const STALE_AFTER_MS = 500;
/** A capture further ahead was told on another clock: nobody knows its age. */
const FUTURE_MS = 100;

export class PictureView extends HTMLElement {
  /** @type {CanvasRenderingContext2D | null} */
  #context = null;
  /** @type {Seat | null} */
  #seat = null;
  /** Of the picture that is shown; null if its stream did not say. @type {number | null} */
  #captureUs = null;
  /** When it was drawn; null before the first one. @type {number | null} */
  #drawnMs = null;
  /** Whether it was captured in the future. */
  #ahead = false;
  #staleAfterMs = STALE_AFTER_MS;
  /** Whether the session has no such stream. */
  #absent = false;
  /** Why it is stale. */
  #why = "";
  #words = make("strong", { class: "stale-words" });
  #reason = make("span", { class: "stale-reason" });
  #mark = make("div", { class: "stale-mark" }, this.#words, this.#reason);
  #damage = make("div", { class: "damage-mark", hidden: true }, "damaged");

  /** Pictures drawn. */
  drawn = 0;
  /** Whether a person sees it by other means than the page's own frames. Those call `handlePainted`. */
  seenElsewhere = false;

  connectedCallback() {
    const canvas = this.canvas;
    this.#context = canvas.getContext("2d", { alpha: false });
    this.append(this.#mark, this.#damage);
    this.tick();
    setInterval(() => this.tick(), TICK_MS);
  }

  /** @returns {HTMLCanvasElement} */
  get canvas() {
    const canvas = this.querySelector("canvas");
    if (canvas === null) throw new Error("picture-view: a canvas is missing");
    return canvas;
  }

  /** Whether what it shows must not be taken for the present. */
  get stale() {
    return this.canvas.dataset.stale !== "false";
  }

  /** Whether it was damaged on its way. */
  get damaged() {
    return !this.#damage.hidden;
  }

  /** The words of its mark, which count while it is stale. */
  get staleWords() {
    return `${this.#words.textContent}: ${this.#reason.textContent}`;
  }

  /** Whether the session has no such picture, so that none is missed. */
  get absent() {
    return this.canvas.dataset.stale === "absent";
  }

  /** @param {Seat} seat */
  follow(seat) {
    this.#seat = seat;
    const { connection } = seat;
    connection.on("frame", (event) => this.#handleFrame(event));
    connection.on("hello", (hello) => {
      const stream = hello.streams.find((one) => this.#shows(one));
      this.#absent = stream === undefined;
      if (this.#steers) connection.paintedUs = this.#absent ? -1 : 0;
      this.#staleAfterMs = stream?.stale_after_ms ?? STALE_AFTER_MS;
      this.tick();
    });
    connection.on("heard", () => this.tick());
    connection.on("lost", () => this.tick());
  }

  /** The age of what is shown, in ms; null if there is nothing, or if its clock is not known. */
  ageMs() {
    const nowUs = this.#seat?.connection.nowUs() ?? null;
    if (nowUs === null || this.#drawnMs === null || this.#captureUs === null) return null;
    const ageMs = (nowUs - this.#captureUs) / 1000;
    this.#ahead = ageMs < -FUTURE_MS;
    return this.#ahead ? null : Math.max(0, ageMs);
  }

  /** Whether a person steers by this picture. */
  get #steers() {
    return this.#shows({ name: "uplink_video", via: "coded" });
  }

  /** @param {{name: string, via: string}} stream */
  #shows(stream) {
    const via = this.getAttribute("via") ?? "coded";
    return stream.name === this.getAttribute("stream") && stream.via === via;
  }

  /** @param {Events["frame"]} event */
  #handleFrame({ of, frame, captureUs, damaged }) {
    if (!this.#shows(of)) return;
    const canvas = this.canvas;
    // Setting a canvas's size clears it, so only a new size is set.
    if (canvas.width !== frame.displayWidth || canvas.height !== frame.displayHeight) {
      canvas.width = frame.displayWidth;
      canvas.height = frame.displayHeight;
    }
    this.#context?.drawImage(frame, 0, 0);
    this.drawn += 1;
    this.#captureUs = captureUs;
    this.#drawnMs = pageMs();
    // A hidden or frozen page paints nothing, although it still draws.
    if (this.#steers && !this.seenElsewhere) requestAnimationFrame(() => this.handlePainted(captureUs));
    if (this.#damage.hidden === damaged) this.#damage.hidden = !damaged;
    if (this.stale) this.tick();
  }

  /** A person sees the picture of this capture. @param {number | null} [captureUs] */
  handlePainted(captureUs = this.#captureUs) {
    if (this.#seat !== null && this.#steers && !this.#absent && this.drawn > 0) this.#seat.connection.paintedUs = captureUs ?? 0;
  }

  /** Why no new picture comes, as far as is known. */
  #cause() {
    const connection = this.#seat?.connection;
    if (this.#absent) return "this setup sends none here";
    if (this.#ahead) return "its clock is not known";
    if (this.hasAttribute("owner") && connection?.alive === true) return "no new picture arrives";
    const hindrance = connection?.hindrance ?? "the server does not answer";
    return hindrance || "no new picture arrives";
  }

  /** Brings age and mark up to date. */
  tick() {
    const ageMs = this.ageMs();
    // Of an undated picture only this is known: it is older than the time since it was drawn.
    const knownMs = ageMs ?? (this.#drawnMs === null ? null : pageMs() - this.#drawnMs);
    const lost = this.#seat?.connection.alive !== true;
    const stale = lost || knownMs === null || this.#ahead || knownMs > this.#staleAfterMs;
    const figure = this.getAttribute("figure");
    if (figure !== null) this.#seat?.figures.setOwn(figure, ageMs === null ? null : Math.round(ageMs));
    this.dispatchEvent(new CustomEvent("age", { detail: { ageMs, stale } }));
    const why = this.#cause();
    if (stale) {
      const age = this.#ahead ? "AGE UNKNOWN" : `STALE ${((knownMs ?? 0) / 1000).toFixed(1)} s`;
      setText(this.#words, knownMs === null ? "NO PICTURE" : age);
      setText(this.#reason, why);
    }
    const text = this.#absent && !lost ? "absent" : String(stale);
    if (this.canvas.dataset.stale === text && (!stale || why === this.#why)) return;
    this.canvas.dataset.stale = this.dataset.stale = text;
    this.#why = why;
    if (this.drawn > 0 && !this.hasAttribute("owner")) announce(stale ? `The picture is stale: ${why}.` : "The picture is live.");
  }
}

customElements.define("picture-view", PictureView);

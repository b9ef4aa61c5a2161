/**
 * `<chat-panel>`: what the people of the session write to each other. A line of this end is pending
 * until the other end has acknowledged it.
 *
 * @import { Seat } from "./seat.js"
 * @import { ChatLine } from "./texts.js"
 */
import { announce } from "./announcer.js";
import { make, setText } from "./dom.js";
import { agoText } from "./wording.js";

/** What a line may have, in octets of UTF-8. */
const MOST_OCTETS = 200;
const encoder = new TextEncoder();

/** By state, beside a line of this end. @type {Record<string, string>} */
const SIGNS = { waiting: "… pending", delivered: "✓ delivered", refused: "✕ not sent", received: "" };

class ChatPanel extends HTMLElement {
  #list = make("ol", { class: "chat-lines", tabindex: "0", "aria-label": "Chat, newest last" });
  #text = make("input", { type: "text", maxlength: "200", placeholder: "Write to all", "aria-label": "Message", autocomplete: "off" });
  #send = make("button", { type: "submit" }, "Send");
  #error = make("p", { class: "small", role: "status", "data-level": "bad" });
  #newest = 0;
  /** @type {Seat | null} */
  #seat = null;

  /** @param {Seat} seat */
  follow(seat) {
    this.#seat = seat;
    const form = make("form", { class: "chat-form" }, this.#text, this.#send);
    form.addEventListener("submit", (event) => {
      event.preventDefault();
      void this.#say();
    });
    const who = make("span", { class: "small quiet" });
    this.append(make("header", {}, make("h2", {}, "Chat"), who), this.#list, form, this.#error);
    const { connection } = seat;
    connection.on("chat", ({ lines }) => this.#show(lines));
    connection.on("hello", ({ role }) => {
      const mayWrite = role !== "viewer";
      this.#text.disabled = this.#send.disabled = !mayWrite;
      setText(who, mayWrite ? `you write as ${this.#name()}` : "you watch only");
    });
  }

  /** As whom this page writes. */
  #name() {
    const hello = this.#seat?.connection.hello ?? null;
    if (hello === null) return "";
    if (hello.role === "operator") return hello.seat === "space" ? "cosmonaut" : "operator";
    return hello.role === "systems" ? "operator" : hello.role;
  }

  async #say() {
    const connection = this.#seat?.connection;
    const text = this.#text.value.trim();
    if (connection === undefined || text === "") return;
    const octets = encoder.encode(text).length;
    if (octets > MOST_OCTETS) {
      setText(this.#error, `too long: leave out about ${octets - MOST_OCTETS} letters`);
      return;
    }
    const { ok, error } = await connection.request({ do: "chat", text });
    setText(this.#error, error);
    if (ok && this.#text.value.trim() === text) this.#text.value = "";
  }

  /** @param {readonly ChatLine[]} lines */
  #show(lines) {
    const nowUs = this.#seat?.connection.nowUs() ?? 0;
    const atEnd = this.#list.scrollTop + this.#list.clientHeight >= this.#list.scrollHeight - 8;
    this.#list.replaceChildren(...lines.map((line) => row(line, nowUs)));
    if (atEnd) this.#list.scrollTop = this.#list.scrollHeight;
    const last = lines.at(-1);
    if (last !== undefined && last.number > this.#newest) {
      if (last.state === "received" && this.#newest > 0) announce(`${last.sender}: ${last.text}`);
      this.#newest = last.number;
    }
  }
}

/** @param {ChatLine} line @param {number} nowUs */
function row({ number, sender, text, state, reason, at_us }, nowUs) {
  const sign = make("span", { class: "chat-state" }, SIGNS[state] ?? state);
  if (reason !== undefined && reason !== "") sign.title = reason;
  return make(
    "li",
    { "data-line": String(number), "data-state": state },
    make("strong", { class: "chat-sender" }, sender),
    make("span", { class: "chat-text" }, text),
    make("time", { class: "quiet", title: `${agoText((nowUs - at_us) / 1e6)} ago` }, ""),
    sign,
  );
}

customElements.define("chat-panel", ChatPanel);

/**
 * `<event-list>`: what happened, the newest first, with a filter by kind. At most 200 rows. Only
 * what a person must know at once is spoken.
 *
 * @import { Seat } from "./seat.js"
 * @import { EventText } from "./texts.js"
 */
import { announce } from "./announcer.js";
import { make } from "./dom.js";
import { clockText } from "./wording.js";

const KEPT = 200;
const SPOKEN = new Set(["link", "process", "stale", "session", "upkeep", "milestone"]);
const KINDS = ["link", "process", "camera", "stale", "joystick", "input", "session", "upkeep", "milestone"];

class EventList extends HTMLElement {
  #newest = -1;
  #began = false;
  #list = make("ol", { class: "events", tabindex: "0", "aria-label": "Events, newest first" });
  /** Kinds that the filter hides. @type {Set<string>} */
  #hidden = new Set();

  /** @param {Seat} seat */
  follow({ connection }) {
    const filter = make("fieldset", { class: "filter" }, make("legend", { class: "only-spoken" }, "Kinds shown"));
    for (const kind of KINDS) {
      const box = make("input", { type: "checkbox", checked: true });
      box.addEventListener("change", () => this.#choose(kind, box.checked));
      filter.append(make("label", {}, box, make("span", {}, kind)));
    }
    this.append(make("header", {}, make("h2", {}, "Events"), filter), this.#list);
    let session = "";
    connection.on("hello", (hello) => {
      if (hello.session !== session) this.#clear();
      session = hello.session;
    });
    connection.on("figures", ({ events, at_us, seconds }) => this.#show(events, at_us - 1e6 * seconds));
  }

  /** Add the events that are new. @param {readonly EventText[]} events @param {number} beganUs When the session began. */
  #show(events, beganUs) {
    const fresh = events.filter(({ number }) => number > this.#newest);
    if (fresh.length === 0) return;
    fresh.sort((one, other) => other.number - one.number);
    this.#newest = fresh[0].number;
    this.#list.prepend(...fresh.slice(0, KEPT).map((event) => this.#row(event, beganUs)));
    while (this.#list.childElementCount > KEPT) this.#list.lastElementChild?.remove();
    // What was before this page came is no news.
    const spoken = fresh.find(({ what }) => SPOKEN.has(what));
    if (this.#began && spoken !== undefined) announce(spoken.text);
    this.#began = true;
  }

  /** Begin anew with another session's events. */
  #clear() {
    this.#newest = -1;
    this.#began = false;
    this.#list.replaceChildren();
  }

  /** @param {EventText} event @param {number} beganUs */
  #row({ at_us: atUs, what, text }, beganUs) {
    const row = make(
      "li",
      { "data-what": what },
      make("time", {}, clockText((atUs - beganUs) / 1e6)),
      make("span", { class: "event-what" }, what),
      make("span", { class: "event-text" }, text),
    );
    row.hidden = this.#hidden.has(what);
    return row;
  }

  /** @param {string} kind @param {boolean} shown */
  #choose(kind, shown) {
    if (shown) this.#hidden.delete(kind);
    else this.#hidden.add(kind);
    for (const row of this.#list.querySelectorAll("li")) {
      row.hidden = this.#hidden.has(row.dataset.what ?? "");
    }
  }
}

customElements.define("event-list", EventList);

/**
 * The tiles of the top line, for what must be seen within a second: whether the link lives, how
 * old the picture is, and who holds the handle. Also the line that names the seat.
 *
 * @import { Seat } from "./seat.js"
 */
import { make, setText } from "./dom.js";
import { PictureView } from "./picture_view.js";
import { linkText } from "./wording.js";

/** With two machines an end's gateway says so; with one there is no such figure. */
const PROTECTED = ["gateways.ground.peer.protected", "gateways.space.peer.protected"];

/** @typedef {"good" | "warn" | "bad" | "none"} Level */

class Tile extends HTMLElement {
  #label = make("span", { class: "label" });
  #value = make("strong", { class: "value" });

  connectedCallback() {
    this.classList.add("tile");
    this.append(this.#label, this.#value);
  }

  /** @param {string} label @param {string} value @param {Level} level */
  show(label, value, level) {
    setText(this.#label, label);
    setText(this.#value, value);
    if (this.dataset.level !== level) this.dataset.level = level;
  }
}

/** `<link-tile>`: whether the radio link lives, and whether anybody could be in it. */
class LinkTile extends Tile {
  /** @param {Seat} seat */
  follow({ connection, figures }) {
    const show = () => {
      const { alive, ended, state, hello } = connection;
      if (ended) {
        this.show("Open the new one's address", "SESSION ENDED", "bad");
        return;
      }
      if (!alive || state === null) {
        this.show(hello === null ? "Connecting" : "Connecting again", "NO SERVER", "bad");
        return;
      }
      const connected = state.link === "connected";
      const open = PROTECTED.some((name) => figures.get(name) === false);
      const words = linkText({ connected, signal: state.signal, open });
      if (connected) this.show(words, "● CONNECTED", open ? "warn" : "good");
      else this.show(words, "✕ LOST", "bad");
    };
    connection.on("state", show);
    connection.on("lost", show);
    show();
  }
}

/** `<age-tile>`: how old the picture of the page's first `picture-view` is. */
class AgeTile extends Tile {
  follow() {
    const view = document.querySelector("picture-view");
    if (!(view instanceof PictureView)) return;
    view.addEventListener("age", () => {
      if (view.absent) {
        this.show("Picture", "NONE HERE", "none");
        return;
      }
      const ageMs = view.ageMs();
      const age = ageMs === null ? "–" : `${ageMs.toFixed(0)} ms`;
      const stale = view.stale;
      const long = ageMs !== null && ageMs >= 10_000 ? `${(ageMs / 1000).toFixed(0)} s` : age;
      this.show(stale ? "Picture: stale" : "Picture: age", long, stale ? "bad" : "good");
    });
  }
}

/** `<hand-tile>`: who holds the handle. */
class HandTile extends Tile {
  /** @param {Seat} seat */
  follow({ connection }) {
    const show = () => {
      const { alive, state, hello } = connection;
      if (!alive || state === null || hello === null) {
        this.show("Handle", "–", "none");
      } else if (hello.joystick !== "page") {
        this.show("Handle", hello.joystick.toUpperCase(), "none");
      } else if (state.hand.you) {
        const steers = state.joystick?.dead_man === true;
        this.show("Handle", steers ? "YOU STEER" : "YOU HAVE IT", "good");
      } else if (state.hand.holder === null) {
        this.show("Handle", "NOBODY", "none");
      } else {
        this.show("Handle", `PAGE ${state.hand.holder}`, "warn");
      }
    };
    connection.on("state", show);
    connection.on("lost", show);
    show();
  }
}

/** By role: what stands beside the page's number. @type {Record<string, string>} */
const PEOPLE = { operator: "", systems: " · systems operator", viewer: " · WATCHES ONLY" };

/** `<seat-name>`: session, setup, page and role. */
class SeatName extends HTMLElement {
  /** @param {Seat} seat */
  follow({ connection }) {
    const role = make("span", { class: "quiet small" });
    this.append(role);
    connection.on("hello", ({ setup, page, role: may }) => {
      setText(role, `${setup} · page ${page}${PEOPLE[may] ?? ` · ${may}`}`);
    });
  }
}

customElements.define("link-tile", LinkTile);
customElements.define("age-tile", AgeTile);
customElements.define("hand-tile", HandTile);
customElements.define("seat-name", SeatName);

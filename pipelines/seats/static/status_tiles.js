/**
 * The tiles of the top line, for what must be seen within a second: whether the link lives, how
 * old the picture is, and who holds the handle. Also the line that names the seat.
 *
 * @import { Seat } from "./seat.js"
 * @import { Level } from "./texts.js"
 */
import { ageTile, handTile, linkTile } from "./conditions.js";
import { make, setText } from "./dom.js";
import { PictureView } from "./picture_view.js";

/** With two machines an end's gateway says so; with one there is no such figure. */
const PROTECTED = ["gateways.ground.peer.protected", "gateways.space.peer.protected"];

class Tile extends HTMLElement {
  #label = make("span", { class: "label" });
  #value = make("strong", { class: "value" });

  connectedCallback() {
    this.classList.add("tile");
    this.append(this.#label, this.#value);
  }

  /** @param {{label: string, value: string, level: Level}} tile */
  show({ label, value, level }) {
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
      const open = PROTECTED.some((name) => figures.get(name) === false);
      this.show(linkTile(connection, open));
    };
    connection.on("state", show);
    connection.on("lost", show);
    show();
  }
}

/** `<age-tile>`: how old the picture of the page's first `picture-view` is. */
class AgeTile extends Tile {
  /** @param {Seat} seat */
  follow({ connection }) {
    const view = document.querySelector("picture-view");
    if (!(view instanceof PictureView)) return;
    view.addEventListener("age", () => {
      this.show(ageTile(connection, view.absent ? null : { ageMs: view.ageMs(), stale: view.stale }));
    });
  }
}

/** `<hand-tile>`: who holds the handle. */
class HandTile extends Tile {
  /** @param {Seat} seat */
  follow({ connection }) {
    const show = () => this.show(handTile(connection));
    connection.on("state", show);
    connection.on("lost", show);
    show();
  }
}

/** `<seat-name>`: the setup, and who sits here. */
class SeatName extends HTMLElement {
  /** @param {Seat} seat */
  follow({ connection }) {
    const role = make("span", { class: "quiet small" });
    this.append(role);
    connection.on("hello", ({ setup, page, name, role: may }) => {
      setText(role, `${setup} · ${name}${may === "viewer" ? ", WATCHES ONLY" : ""}`);
      this.dataset.page = String(page);
    });
  }
}

customElements.define("link-tile", LinkTile);
customElements.define("age-tile", AgeTile);
customElements.define("hand-tile", HandTile);
customElements.define("seat-name", SeatName);

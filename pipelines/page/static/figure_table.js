/**
 * `<figure-table>`: every figure of the session by its name in the report, with a search.
 *
 * @import { Seat } from "./seat.js"
 */
import { make } from "./dom.js";

class FigureTable extends HTMLElement {
  /** @type {Map<string, HTMLElement>} */
  #rows = new Map();
  #list = make("dl", { class: "figures" });
  #search = make("input", { type: "search", placeholder: "part of a name", "aria-label": "Search figures" });

  /** @param {Seat} seat */
  follow({ connection, figures }) {
    this.#search.addEventListener("input", () => this.#filter());
    this.append(this.#search, this.#list);
    connection.on("figures", (text) => {
      if (this.#have(Object.keys(text.figures))) figures.refresh();
    });
  }

  /** Have a row for each name. @param {readonly string[]} names @returns {boolean} Whether there are new ones. */
  #have(names) {
    const fresh = names.filter((name) => !this.#rows.has(name));
    for (const name of fresh) {
      const row = make("div", {}, make("dt", { title: name }, name), make("dd", { class: "number", "data-figure": name }));
      this.#rows.set(name, row);
      this.#list.append(row);
    }
    if (fresh.length > 0) this.#filter();
    return fresh.length > 0;
  }

  #filter() {
    const wanted = this.#search.value.trim().toLowerCase();
    for (const [name, row] of this.#rows) row.hidden = !name.toLowerCase().includes(wanted);
  }
}

customElements.define("figure-table", FigureTable);

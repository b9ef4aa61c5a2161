/**
 * `<figure-table>`: every figure of the session by its name in the report, with a search. There are
 * hundreds, so they are in groups that are closed at first: what is closed costs no layout.
 *
 * @import { Seat } from "./seat.js"
 */
import { make } from "./dom.js";

/** Groups below these are named by two parts of a figure's name. */
const DEEP = ["processes", "link", "gateways", "haptic"];

/** @param {string} name */
function groupOf(name) {
  const [first, second] = name.split(".");
  return DEEP.includes(first) ? `${first}.${second}` : first;
}

class FigureTable extends HTMLElement {
  /** By name. @type {Map<string, HTMLElement>} */
  #rows = new Map();
  /** By name. @type {Map<string, {details: HTMLDetailsElement, list: HTMLElement}>} */
  #groups = new Map();
  #search = make("input", { type: "search", placeholder: "part of a name", "aria-label": "Search figures" });

  /** @param {Seat} seat */
  follow({ connection, figures }) {
    this.#search.addEventListener("input", () => this.#filter());
    this.append(this.#search);
    connection.on("figures", (text) => {
      const fresh = Object.keys(text.figures).filter((name) => !this.#rows.has(name));
      for (const name of fresh) this.#add(name);
      if (fresh.length > 0) figures.refresh();
    });
  }

  /** @param {string} name */
  #add(name) {
    const group = groupOf(name);
    const value = make("dd", { "data-figure": name });
    const short = name.slice(group.length + 1) || name;
    const row = make("div", { title: name }, make("dt", {}, short), value);
    this.#rows.set(name, row);
    this.#group(group).list.append(row);
  }

  /** @param {string} name */
  #group(name) {
    const known = this.#groups.get(name);
    if (known !== undefined) return known;
    const list = make("dl", { class: "figures" });
    const details = make("details", {}, make("summary", {}, name), list);
    const group = { details, list };
    this.#groups.set(name, group);
    this.append(details);
    return group;
  }

  #filter() {
    const wanted = this.#search.value.trim().toLowerCase();
    for (const { details } of this.#groups.values()) details.hidden = true;
    for (const [name, row] of this.#rows) {
      row.hidden = !name.toLowerCase().includes(wanted);
      const { details } = this.#group(groupOf(name));
      if (!row.hidden) details.hidden = false;
      details.open = wanted.length > 1;
    }
  }
}

customElements.define("figure-table", FigureTable);

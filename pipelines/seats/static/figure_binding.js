/**
 * Puts figures into the elements that ask for them.
 *
 * `[data-figure=NAME]` has the bare value as its text: a number without a unit, a word, or "–".
 * `data-decimals` on the element says how many decimals; without it, a number below 100 has one.
 * `[data-figure-in=NAME]` is for people: `data-scale` is a factor, for example 0.001 for kbit/s.
 *
 * @import { Connection } from "./connection.js"
 * @import { Figure } from "./texts.js"
 */

/** What stands where there is no value. */
export const NOTHING = "–";

/**
 * The numbers whose names begin so, by the rest of their names.
 * @param {Readonly<Record<string, Figure>>} figures @param {string} prefix
 */
export function countsBelow(figures, prefix) {
  /** @type {Record<string, number>} */
  const counts = {};
  for (const [name, value] of Object.entries(figures)) {
    if (typeof value === "number" && name.startsWith(prefix)) counts[name.slice(prefix.length)] = value;
  }
  return counts;
}

/** A figure as text. @param {Figure | undefined} value @param {number} [decimals] */
function figureText(value, decimals) {
  if (value === null || value === undefined) return NOTHING;
  if (typeof value !== "number") return String(value);
  if (!Number.isFinite(value)) return NOTHING;
  const places = decimals ?? (Number.isInteger(value) || Math.abs(value) >= 100 ? 0 : 1);
  const text = value.toFixed(places);
  // "-0.0" would move the digits.
  return Number(text) === 0 ? text.replace("-", "") : text;
}

export class FigureBinding {
  /** @type {Map<string, Figure>} */
  #values = new Map();
  /** Figures that the page computes itself; the launcher's are ignored. @type {Set<string>} */
  #own = new Set();
  /** @type {Map<string, Element[]>} */
  #elements = new Map();
  #root;

  /** @param {ParentNode} root */
  constructor(root = document) {
    this.#root = root;
    this.refresh();
  }

  /** @param {Connection} connection */
  follow(connection) {
    connection.on("figures", ({ figures }) => {
      for (const [name, value] of Object.entries(figures)) {
        if (!this.#own.has(name)) this.#set(name, value);
      }
    });
  }

  /** Looks again which elements ask for figures; call it after adding or removing some. */
  refresh() {
    this.#elements.clear();
    for (const element of this.#root.querySelectorAll("[data-figure], [data-figure-in]")) {
      const name = nameOf(element);
      this.#elements.set(name, [...(this.#elements.get(name) ?? []), element]);
      write(element, this.#values.get(name));
    }
  }

  /** @param {string} name */
  get(name) {
    return this.#values.get(name) ?? null;
  }

  /** The figure as a number, or null. @param {string} name */
  number(name) {
    const value = this.get(name);
    return typeof value === "number" ? value : null;
  }

  /** A figure that the page computes itself. @param {string} name @param {Figure} value */
  setOwn(name, value) {
    this.#own.add(name);
    this.#set(name, value);
  }

  /** @param {string} name @param {Figure} value */
  #set(name, value) {
    this.#values.set(name, value);
    for (const element of this.#elements.get(name) ?? []) write(element, value);
  }
}

/** @param {Element} element */
const nameOf = (element) =>
  element.getAttribute("data-figure") ?? element.getAttribute("data-figure-in") ?? "";

/** @param {Element} element @param {Figure | undefined} value */
function write(element, value) {
  const decimals = element.getAttribute("data-decimals");
  const scale = element.hasAttribute("data-figure-in") ? element.getAttribute("data-scale") : null;
  const scaled = typeof value === "number" && scale !== null ? value * Number(scale) : value;
  const text = figureText(scaled, decimals === null ? undefined : Number(decimals));
  if (element.textContent !== text) element.textContent = text;
}

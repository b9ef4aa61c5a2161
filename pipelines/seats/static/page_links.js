/**
 * `<page-links>`: the other pages of this end, which the same token opens.
 *
 * @import { Seat } from "./seat.js"
 */
import { make } from "./dom.js";

/** Where a viewer finds something to watch. */
const WATCHED = ["space", "panel", "ground", "k2sv"];

/** By end: address and name of its pages. @type {Record<string, [string, string][]>} */
const PAGES = {
  space: [
    ["space", "Operator"],
    ["panel", "Panel"],
    ["k2cp", "K2CP"],
  ],
  ground: [
    ["ground", "Ground"],
    ["top", "TOP-UI"],
    ["k2sv", "K2SV"],
    ["systems", "Systems"],
  ],
};

class PageLinks extends HTMLElement {
  /** @param {Seat} seat */
  follow({ connection }) {
    const token = new URL(document.baseURI).pathname.split("/")[1] ?? "";
    connection.on("hello", ({ seat, tasks, role }) => {
      const here = location.pathname.slice(1);
      /** @type {[string, string][]} */
      const own = role === "trainer" ? [["trainer", "Trainer"]] : [];
      const shown = [...(PAGES[seat] ?? []), ...own].filter(
        ([page]) => page === here || ((tasks || !["panel", "top"].includes(page)) && (role !== "viewer" || WATCHED.includes(page))),
      );
      const links = shown.map(([page, name]) =>
        make("a", { href: `${location.origin}/${page}?token=${token}`, ...(page === here ? { "aria-current": "page" } : {}) }, name),
      );
      links.unshift(make("a", { href: `${location.origin}/?token=${token}`, title: "Choose another seat" }, "Seats"));
      this.replaceChildren(make("nav", { "aria-label": "Pages of this end" }, ...links));
    });
  }
}

customElements.define("page-links", PageLinks);

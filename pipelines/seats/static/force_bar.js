/** `<force-bar>`: the size of the force as a bar and in newtons, and how hard the robot presses. */
import { FULL_N, forceShare } from "./force_view.js";
import { make, setText } from "./dom.js";

export class ForceBar extends HTMLElement {
  #fill = make("span", { class: "force-fill" });
  #value = make("strong", {}, "–");
  #contact = make("span", { class: "force-contact", hidden: true }, "contact");
  #presses = make("span", { class: "quiet small" });

  connectedCallback() {
    this.setAttribute("role", "meter");
    this.setAttribute("aria-label", "Force");
    this.setAttribute("aria-valuemin", "0");
    this.setAttribute("aria-valuemax", String(FULL_N));
    this.append(
      make("span", { class: "force-words" }, this.#value, make("span", { class: "unit" }, "N"), this.#contact, this.#presses),
      make("span", { class: "force-scale" }, this.#fill),
    );
  }

  /** @param {number | null} forceN @param {boolean} contact @param {number} pressesN */
  show(forceN, contact, pressesN) {
    setText(this.#value, forceN === null ? "–" : forceN.toFixed(1));
    this.#fill.style.transform = `scaleX(${forceShare(forceN ?? 0).toFixed(3)})`;
    this.setAttribute("aria-valuenow", (forceN ?? 0).toFixed(1));
    setText(this.#presses, contact ? `the robot presses with ${pressesN.toFixed(1)} N` : "");
    if (this.#contact.hidden === contact) this.#contact.hidden = !contact;
  }
}

customElements.define("force-bar", ForceBar);

/**
 * `<tab-group>` around sections with an id and a `data-tab` title: one of them is shown at a time.
 * What a panel's event "alert" says stands beside its title. Arrow keys, Home and End move between
 * the tabs (WAI-ARIA Authoring Practices, "Tabs").
 *
 * @import { Seat } from "./seat.js"
 */
import { make, setText } from "./dom.js";

class TabGroup extends HTMLElement {
  /** @type {HTMLElement[]} */
  #panels = [];
  /** @type {HTMLButtonElement[]} */
  #tabs = [];

  connectedCallback() {
    if (this.#tabs.length > 0) return;
    this.#panels = [...this.querySelectorAll(":scope > [data-tab]")].filter((one) => one instanceof HTMLElement);
    const list = make("div", { role: "tablist", "aria-label": this.getAttribute("label") ?? "" });
    for (const panel of this.#panels) {
      const tab = make(
        "button",
        { type: "button", role: "tab", id: `tab-${panel.id}`, "aria-controls": panel.id },
        panel.dataset.tab ?? "",
      );
      tab.addEventListener("click", () => this.#show(panel.id, false));
      panel.setAttribute("role", "tabpanel");
      panel.setAttribute("aria-labelledby", tab.id);
      const alert = make("span", { class: "tab-alert" });
      tab.append(alert);
      panel.addEventListener("alert", (event) => {
        if (event instanceof CustomEvent) setText(alert, String(event.detail));
      });
      this.#tabs.push(tab);
      list.append(tab);
    }
    list.addEventListener("keydown", (event) => this.#move(event));
    this.prepend(list);
    if (this.#panels.length > 0) this.#show(this.#panels[0].id, false);
  }

  /** @param {Seat} seat */
  follow({ keyboard }) {
    keyboard.add({
      keys: this.#panels.map((_, index) => String(index + 1)),
      shown: `1 … ${this.#panels.length}`,
      what: "open a tab",
      down: (key) => {
        const panel = this.#panels[Number(key) - 1];
        if (panel !== undefined) this.#show(panel.id, false);
      },
    });
  }

  /** @param {string} id @param {boolean} focus */
  #show(id, focus) {
    this.#panels.forEach((panel, index) => {
      const shown = panel.id === id;
      const tab = this.#tabs[index];
      panel.hidden = !shown;
      tab.setAttribute("aria-selected", String(shown));
      tab.tabIndex = shown ? 0 : -1;
      if (shown && focus) tab.focus();
    });
  }

  /** @param {KeyboardEvent} event */
  #move(event) {
    const at = this.#tabs.findIndex((tab) => tab.getAttribute("aria-selected") === "true");
    const last = this.#tabs.length - 1;
    const to = { ArrowRight: at === last ? 0 : at + 1, ArrowLeft: at === 0 ? last : at - 1, Home: 0, End: last }[event.key];
    if (to === undefined) return;
    event.preventDefault();
    this.#show(this.#panels[to].id, true);
  }
}

customElements.define("tab-group", TabGroup);

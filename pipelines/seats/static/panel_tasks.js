/**
 * `<panel-tasks>`: all tasks of the session, the current one marked. The cosmonaut selects none.
 *
 * @import { Seat } from "./seat.js"
 */
import { make, setAttribute } from "./dom.js";
import { nameText } from "./wording.js";

class PanelTasks extends HTMLElement {
  /** By name. @type {Map<string, HTMLElement>} */
  #items = new Map();
  #list = make("ol", { class: "panel-tasks" });

  /** @param {Seat} seat */
  follow({ connection }) {
    this.append(make("header", {}, make("h2", {}, "Tasks")), this.#list);
    connection.on("hello", ({ task_list: tasks }) => {
      this.#items.clear();
      this.#list.replaceChildren();
      for (const { name, lacks } of tasks) this.#add(name, lacks);
      this.hidden = false;
    });
    connection.on("panel", ({ task }) => {
      if (task !== "" && !this.#items.has(task)) this.#add(task);
      for (const [name, item] of this.#items) {
        setAttribute(item, "aria-current", name === task ? "true" : null);
      }
    });
  }

  /** @param {string} name @param {string} [lacks] why it cannot be done here */
  #add(name, lacks = "") {
    const item = make("li", { "data-task": name }, nameText(name));
    if (lacks !== "") item.append(make("span", { class: "small" }, ` Not available: it ${lacks}.`));
    this.#items.set(name, item);
    this.#list.append(item);
  }
}

customElements.define("panel-tasks", PanelTasks);

/**
 * `<milestone-list>`: the milestones that `kontur-av maintain` has confirmed, the newest first.
 *
 * @import { Seat } from "./seat.js"
 */
import { make } from "./dom.js";
import { clockText } from "./wording.js";

const KEPT = 20;

class MilestoneList extends HTMLElement {
  /** @param {Seat} seat */
  follow({ connection }) {
    const none = make("p", { class: "small quiet" }, "None is reached yet.");
    const list = make("ol", { class: "log" });
    this.append(make("header", {}, make("h2", {}, "Milestones")), none, list);
    let newest = -1;
    connection.on("hello", () => {
      newest = -1;
      list.replaceChildren();
    });
    connection.on("figures", ({ events, at_us: atUs, seconds }) => {
      for (const event of events) {
        if (event.what !== "milestone" || event.number <= newest) continue;
        newest = event.number;
        const at = clockText(seconds - (atUs - event.at_us) / 1e6);
        list.prepend(make("li", { class: "milestone" }, make("time", {}, at), make("span", { class: "log-what" }, event.text)));
      }
      while (list.childElementCount > KEPT) list.lastElementChild?.remove();
      none.hidden = list.childElementCount > 0;
    });
  }
}

customElements.define("milestone-list", MilestoneList);

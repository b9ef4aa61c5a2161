/**
 * `<process-grid>`: all processes with their CPU time and restarts. One that is dead or was
 * restarted stands out; how many are dead is also an event "alert", for the title of its tab.
 *
 * @import { Seat } from "./seat.js"
 * @import { ProcessText } from "./texts.js"
 */
import { make, setAttribute, setText } from "./dom.js";
import { nameText } from "./wording.js";

/**
 * @typedef {object} Row
 * @property {HTMLElement} item
 * @property {HTMLElement} cpu
 * @property {HTMLMeterElement} meter
 * @property {HTMLElement} note
 */

class ProcessGrid extends HTMLElement {
  /** @type {Map<string, Row>} */
  #rows = new Map();
  #total = make("p", { class: "process-total" });

  /** @param {Seat} seat */
  follow({ connection }) {
    connection.on("figures", ({ processes, state }) => this.#showAll(processes, state === "stopped"));
  }

  /** @param {readonly ProcessText[]} processes @param {boolean} stopped Then none is missed. */
  #showAll(processes, stopped) {
    if (processes.length !== this.#rows.size || processes.some(({ name }) => !this.#rows.has(name))) {
      this.#build(processes);
    }
    let [cpu, restarts, dead] = [0, 0, 0];
    for (const process of processes) {
      cpu += process.cpu ?? 0;
      restarts += process.restarts;
      if (process.state !== "running" || process.trouble !== "") dead += 1;
      this.#show(process, stopped);
    }
    const ill = dead > 0 ? `, ${dead} not well` : "";
    const again = restarts > 0 ? `, ${restarts} restart${restarts > 1 ? "s" : ""}` : "";
    const alert = dead > 0 && !stopped ? `${dead} not well` : "";
    this.dispatchEvent(new CustomEvent("alert", { bubbles: true, detail: alert }));
    setText(this.#total, `${processes.length} processes, ${cpu.toFixed(2)} cores${ill}${again}`);
  }

  /** @param {ProcessText} process @param {boolean} stopped */
  #show({ name, cpu, restarts, state, error, trouble }, stopped) {
    const row = this.#rows.get(name);
    if (row === undefined) return;
    setText(row.cpu, cpu === null ? "–" : `${(100 * cpu).toFixed(1)} %`);
    row.meter.value = Math.min(1, cpu ?? 0);
    const running = state === "running";
    const ill = stopped && !running ? "stopped" : "dead";
    const look = !running || trouble ? ill : restarts > 0 ? "restarted" : "well";
    setAttribute(row.item, "data-state", look);
    const again = restarts > 0 ? `restarted ${restarts}×` : "";
    setText(row.note, `${!running ? "not running " : trouble ? "not well " : ""}${again}`.trim());
    setAttribute(row.item, "title", trouble || error || null);
  }

  /** @param {readonly ProcessText[]} processes */
  #build(processes) {
    this.#rows.clear();
    /** @type {Map<string, ProcessText[]>} */
    const segments = new Map();
    for (const process of processes) {
      const segment = process.segment ?? "both";
      segments.set(segment, [...(segments.get(segment) ?? []), process]);
    }
    const lists = [...segments].map(([segment, members]) =>
      make(
        "section",
        {},
        make("h3", {}, segment),
        make("ul", { class: "processes" }, ...members.map((process) => this.#row(process.name))),
      ),
    );
    this.replaceChildren(this.#total, ...lists);
  }

  /** @param {string} name */
  #row(name) {
    const cpu = make("span", { class: "number" });
    const meter = make("meter", { min: "0", max: "1", high: "0.8", "aria-label": `CPU of ${nameText(name)}` });
    const note = make("span", { class: "process-note" });
    const item = make("li", {}, make("span", { class: "process-name" }, nameText(name)), meter, cpu, note);
    this.#rows.set(name, { item, cpu, meter, note });
    return item;
  }
}

customElements.define("process-grid", ProcessGrid);

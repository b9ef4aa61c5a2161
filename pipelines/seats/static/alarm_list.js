/**
 * `<alarm-list>`: every parameter that is beyond a limit or in a bad state, the worst first, above all
 * else on the page.
 *
 * @import { Seat } from "./seat.js"
 */
import { announce } from "./announcer.js";
import { hindranceOf } from "./conditions.js";
import { make } from "./dom.js";
import { Telemetry, alarmsOf } from "./telemetry.js";

const TICK_MS = 500;
/** @type {Record<string, string>} */
const SIGNS = { warn: "▲", bad: "✕", none: "●" };

class AlarmList extends HTMLElement {
  #shown = "";

  /** @param {Seat} seat */
  follow({ connection }) {
    const telemetry = new Telemetry(connection);
    const list = make("ul", { "aria-label": "Alarms" });
    this.append(list);
    const show = () => {
      // Then all that is known is old, and the line above says why.
      this.hidden = !connection.alive;
      const alarms = alarmsOf(telemetry, connection.nowUs());
      const away = hindranceOf(connection) === "" ? "" : " here; nothing is heard of the other end";
      const rows = alarms.length > 0 ? alarms : [{ level: "none", words: `No alarm${away}.` }];
      const shown = rows.map(({ words }) => words).join();
      if (shown === this.#shown) return;
      if (alarms.length > 0 && !this.#shown.includes(alarms[0].words)) announce(`Alarm: ${alarms[0].words}`);
      this.#shown = shown;
      list.replaceChildren(...rows.map(({ level, words }) => make("li", { "data-level": level }, `${SIGNS[level]} ${words}`)));
    };
    telemetry.onchange = show;
    connection.on("state", show);
    setInterval(show, TICK_MS);
  }
}

customElements.define("alarm-list", AlarmList);

/**
 * `<robot-map>`: the task board with the robot's stylus, its force as an arrow, what it touches and
 * the lit LED.
 *
 * @import { Seat } from "./seat.js"
 * @import { Row } from "./newest_row.js"
 */
import { boardOf, drivesPartners } from "./conditions.js";
import { make, setText } from "./dom.js";
import { drawOften } from "./drawing_loop.js";
import { NewestRow } from "./newest_row.js";
import { LED_NAMES, WorkspaceMap } from "./workspace_map.js";

/** People read no faster, and each change of a text is laid out. */
const SAY_MS = 200;

class RobotMap extends HTMLElement {
  #map = new WorkspaceMap();
  #contact = make("strong");
  #force = make("dd");
  #placeLabel = make("dt");
  #place = make("dd");

  /** @param {Seat} seat */
  follow({ connection }) {
    const { canvas } = this.#map;
    canvas.setAttribute("role", "img");
    canvas.setAttribute("aria-label", "Task board with the robot's stylus and its force");
    this.append(
      canvas,
      make("dl", { class: "values" }, make("dt", {}, "Stylus"), make("dd", {}, this.#contact), make("dt", {}, "Force"), this.#force, this.#placeLabel, this.#place),
    );
    const robot = new NewestRow(connection, "robot");
    /** @type {Row | null | undefined} */
    let drawn;
    let said = 0;
    connection.on("hello", () => {
      drawn = undefined;
    });
    drawOften(this, () => {
      const handle = robot.row;
      if (performance.now() - said >= SAY_MS) {
        said = performance.now();
        this.#say(handle);
        // Its samples do not say where the partner's robot is.
        setText(this.#placeLabel, drivesPartners(connection) ? "Partner's robot is wanted at" : "Position x, y");
      }
      if (connection.hello === null || handle === drawn) return;
      drawn = handle;
      const board = boardOf(connection, connection.hello.board);
      const workspace = { half_width_m: board.width_m / 2, half_height_m: board.height_m / 2 };
      this.#map.show({ workspace, board, handle, target: handle, start: null });
    });
  }

  /** @param {Row | null} row */
  #say(row) {
    const led = row === null || row.lit === null ? "" : `, LED ${LED_NAMES[row.lit]}`;
    setText(this.#contact, row === null ? "no samples" : row.contact ? `CONTACT${led}` : "free");
    this.#contact.dataset.contact = String(row?.contact === true);
    const force = row === null ? "–" : `${Math.hypot(row.forceXN, row.forceYN).toFixed(1)} N`;
    setText(this.#force, force);
    const mm = (/** @type {number} */ m) => (1000 * m).toFixed(0);
    setText(this.#place, row === null ? "–" : `${mm(row.xM)}, ${mm(row.yM)} mm`);
  }
}

customElements.define("robot-map", RobotMap);

/**
 * `<contact-panel>`: signal and state of both ways of the link, delays, the present instant in the
 * pass, and the path to another machine.
 *
 * @import { Seat } from "./seat.js"
 */
import { make, setText } from "./dom.js";
import { NOTHING } from "./figure_binding.js";
import { pathList } from "./path_list.js";
import { connectedS, linkObstacle } from "./wording.js";

const MS_PER_NS = "0.000001";

class ContactPanel extends HTMLElement {
  #uplink = make("dd");
  #downlink = make("dd");
  #since = make("dd");
  #until = make("dd");
  #obstacle = make("p", { class: "small", role: "alert", "data-level": "bad", hidden: true });

  /** @param {Seat} seat */
  follow(seat) {
    const { connection } = seat;
    const state = make("span", { class: "small", "data-figure": "gateways.space.supervision.state" });
    this.append(
      make("header", {}, make("h2", {}, "Contact"), state),
      this.#obstacle,
      make(
        "dl",
        { class: "values" },
        ...row("Up to space", this.#uplink),
        ...row("Down to ground", this.#downlink),
        ...row("Delay up", delay("gateways.ground.radio.delay_ns")),
        ...row("Delay down", delay("gateways.space.radio.delay_ns")),
        ...row("Repair up", losses("link.uplink")),
        ...row("Repair down", losses("link.downlink")),
        ...row("In contact for", this.#since),
        ...row("Loss of signal in", this.#until),
      ),
      pathList(seat),
    );
    const show = () => this.#show(seat);
    connection.on("figures", show);
    connection.on("lost", show);
    show();
  }

  /** @param {Seat} seat */
  #show({ connection, figures }) {
    const { alive } = connection;
    const obstacle = alive ? linkObstacle(figures) : "";
    this.#obstacle.hidden = obstacle === "";
    setText(this.#obstacle, obstacle);
    showWay(this.#uplink, alive ? figures.get("gateways.space.supervision.signal") : null);
    showWay(this.#downlink, alive ? figures.get("gateways.ground.supervision.signal") : null);
    // Without a pass the link itself says since when it is connected.
    const linkS = connectedS(figures, "space", connection.nowUs());
    const sinceS = figures.number("contact.since_acquisition_s") ?? linkS;
    const untilS = figures.number("contact.until_loss_s");
    setText(this.#since, sinceS === null ? "–" : minutes(sinceS));
    setText(this.#until, untilS === null ? "none planned" : minutes(untilS));
    const level = untilS === null ? "none" : untilS < 10 ? "bad" : untilS < 60 ? "warn" : "good";
    this.#until.dataset.level = level;
  }
}

/** @param {string} name @param {HTMLElement} value */
const row = (name, value) => [make("dt", {}, name), value];

/** @param {string} name */
function delay(name) {
  const value = make("span", { "data-figure-in": name, "data-scale": MS_PER_NS, "data-decimals": "1" });
  return make("dd", {}, value, make("span", { class: "unit" }, "ms"));
}

/** How many of the lost frames repair restored, and its mode. @param {string} direction */
function losses(direction) {
  const [restored, lost, mode] = ["repaired.zones", "frames_lost", "repair_sent.mode"].map((figure) =>
    make("span", { "data-figure": `${direction}.${figure}` }),
  );
  mode.className = "unit";
  return make("dd", {}, restored, " of ", lost, " ", mode);
}

/** @param {HTMLElement} element @param {unknown} signal */
function showWay(element, signal) {
  setText(element, signal === true ? "● signal" : signal === false ? "✕ no signal" : NOTHING);
  element.dataset.level = signal === true ? "good" : signal === false ? "bad" : "none";
}

/** Seconds as minutes and seconds. @param {number} seconds */
function minutes(seconds) {
  const whole = Math.abs(Math.trunc(seconds));
  const sign = seconds < 0 ? "−" : "";
  return `${sign}${Math.floor(whole / 60)}:${String(whole % 60).padStart(2, "0")}`;
}

customElements.define("contact-panel", ContactPanel);

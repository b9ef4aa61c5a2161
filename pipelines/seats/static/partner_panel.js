/**
 * `<partner-panel>` around a picture-view: a partner across the Internet, seen and heard at the
 * ground, and how it is connected. Hidden in a session without a leg to it.
 *
 * @import { Seat } from "./seat.js"
 */
import { make, setText } from "./dom.js";
import { LevelMeter } from "./level_meter.js";
import { SoundPlayer, bindSoundAge } from "./sound_player.js";
import { millisecondsText, rateText } from "./wording.js";

const CAMERA = "rtc_camera";
const VOICE = "rtc_voice";

class PartnerPanel extends HTMLElement {
  #words = make("span", { class: "quiet small" });
  #mute = make("button", { type: "button", "aria-pressed": "false" }, "Mute");
  #meter = new LevelMeter();
  /** @type {SoundPlayer | null} */
  #player = null;

  /** @param {Seat} seat */
  follow({ connection, figures }) {
    this.#meter.setAttribute("aria-label", "Level of the partner's voice");
    this.prepend(make("header", {}, make("h2", {}, "Partner"), this.#words));
    this.append(make("div", { class: "sound-row" }, this.#mute, this.#meter));
    this.#mute.addEventListener("click", () => {
      if (this.#player === null) return;
      this.#player.muted = !this.#player.muted;
      this.#mute.setAttribute("aria-pressed", String(this.#player.muted));
    });
    connection.on("hello", ({ streams }) => {
      this.hidden = !streams.some((one) => one.name === CAMERA);
      if (this.hidden || this.#player !== null) return;
      const player = (this.#player = new SoundPlayer(connection, VOICE));
      player.onchange = () => this.#meter.set(player.peak);
      bindSoundAge(player, figures, `${VOICE}.age_ms`);
      void player.start();
    });
    connection.on("figures", () => {
      const partners = figures.number("rtc.partners") ?? 0;
      this.dataset.connected = String(partners > 0);
      const parts = [
        `picture at ${rateText(figures.number("rtc.rate_bps"))}`,
        `round trip ${millisecondsText(figures.number("rtc.round_trip_ms"))}`,
      ];
      setText(this.#words, partners > 0 ? parts.join(", ") : "nobody is connected");
    });
  }
}

customElements.define("partner-panel", PartnerPanel);

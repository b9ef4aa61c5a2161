/**
 * `<loudspeaker-panel stream="uplink_voice" figure="uplink_voice.age_ms">`: plays a voice; mute,
 * volume, level, and how late the loudspeaker is.
 *
 * @import { Seat } from "./seat.js"
 */
import { make, setText } from "./dom.js";
import { LevelMeter } from "./level_meter.js";
import { SoundPlayer, bindSoundAge } from "./sound_player.js";

class LoudspeakerPanel extends HTMLElement {
  /** @param {Seat} seat */
  follow({ connection, figures, keyboard }) {
    const stream = this.getAttribute("stream") ?? "";
    const player = new SoundPlayer(connection, stream);
    const mute = make("button", { type: "button", "aria-pressed": "false" }, "Mute", make("kbd", {}, "M"));
    const volume = make("input", { type: "range", min: "0", max: "1", step: "0.05", value: "1", "aria-label": "Loudspeaker volume" });
    const meter = new LevelMeter();
    meter.setAttribute("aria-label", "Level of the voice");
    const words = make("span", { class: "quiet small" });
    this.append(make("header", {}, make("h2", {}, "Loudspeaker"), words), make("div", { class: "sound-row" }, mute, volume, meter));
    const toggle = () => {
      player.muted = !player.muted;
      mute.setAttribute("aria-pressed", String(player.muted));
    };
    mute.addEventListener("click", toggle);
    volume.addEventListener("input", () => {
      player.volume = volume.valueAsNumber;
    });
    keyboard.add({ keys: ["m"], what: "mute the loudspeaker", down: toggle });
    player.onchange = () => {
      meter.set(player.peak);
      setText(words, player.words);
    };
    words.addEventListener("pointerenter", () => {
      words.title = player.details;
    });
    const figure = this.getAttribute("figure");
    if (figure !== null) bindSoundAge(player, figures, figure);
    void player.start();
  }
}

customElements.define("loudspeaker-panel", LoudspeakerPanel);

/** `<level-meter aria-label="...">`: a peak between 0 and 1 on a scale from -60 to 0 dB. */

const FLOOR_DB = -60;
/** How far the bar falls in a tenth of a second. */
const FALL_DB = 4;

export class LevelMeter extends HTMLElement {
  #db = FLOOR_DB;
  #bar = document.createElement("span");

  connectedCallback() {
    this.setAttribute("role", "meter");
    this.setAttribute("aria-valuemin", String(FLOOR_DB));
    this.setAttribute("aria-valuemax", "0");
    this.append(this.#bar);
    this.set(0);
  }

  /** Nothing is measured any more. */
  clear() {
    this.#db = Math.min(this.#db, FLOOR_DB + FALL_DB);
    this.set(0);
  }

  /** @param {number} peak */
  set(peak) {
    const db = peak > 0 ? Math.max(FLOOR_DB, 20 * Math.log10(peak)) : FLOOR_DB;
    const shown = Math.round(Math.max(db, this.#db - FALL_DB, FLOOR_DB));
    if (shown === this.#db && this.dataset.hot !== undefined) return;
    this.#db = shown;
    this.#bar.style.transform = `scaleX(${(1 - this.#db / FLOOR_DB).toFixed(3)})`;
    this.dataset.hot = String(this.#db > -3);
    this.setAttribute("aria-valuenow", this.#db.toFixed(0));
  }
}

customElements.define("level-meter", LevelMeter);

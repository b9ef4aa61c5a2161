/**
 * The axes behind x and y: a slider each, which shows where the axis is and moves it.
 *
 * Holding a slider is a press of the dead-man button, as holding the map is. While something else
 * presses, sliders and keys move their axis, too.
 *
 * @import { HandControl } from "./hand_control.js"
 * @import { Keyboard } from "./keyboard.js"
 * @import { AxisText } from "./texts.js"
 */
import { make, setText } from "./dom.js";

const STEP = 0.01;
const KEY_MS = 30;

/** @typedef {{input: HTMLInputElement, value: HTMLElement}} Row */

export class AxisSliders extends HTMLElement {
  #control;
  /** @type {Row[]} */
  #rows = [];
  #names = "";
  /** The axis that the keys move. */
  #chosen = 0;

  /** @param {HandControl} control @param {Keyboard} keyboard */
  constructor(control, keyboard) {
    super();
    this.#control = control;
    this.hidden = true;
    control.addEventListener("target", () => this.#follow());
    keyboard.add(
      this.#key("PageUp", 1),
      this.#key("PageDown", -1),
      { keys: ["g"], what: "with more axes: choose the next one", down: () => this.#choose(this.#chosen + 1) },
    );
  }

  /** @param {readonly AxisText[]} axes */
  show(axes) {
    const names = axes.map(({ name }) => name).join(" ");
    if (names !== this.#names) this.#build(names, axes);
    axes.forEach(({ position, half_range, force, unit }, axis) => {
      const row = /** @type {Row} */ (this.#rows[axis]);
      const rotates = unit === "rad";
      const where = rotates ? `${((position * 180) / Math.PI).toFixed(0)}°` : `${(1000 * position).toFixed(1)} mm`;
      setText(row.value, `${where}, ${force.toFixed(rotates ? 2 : 1)} ${rotates ? "N m" : "N"}`);
      if (this.#control.axisTarget(axis) === null) row.input.value = String(position / half_range);
    });
  }

  /** @param {string} names @param {readonly AxisText[]} axes */
  #build(names, axes) {
    this.#names = names;
    this.#rows = axes.map(({ name }, axis) => {
      const input = make("input", { type: "range", min: "-1", max: "1", step: String(STEP), "aria-label": name });
      input.addEventListener("pointerdown", () => {
        this.#choose(axis);
        this.#control.press("axis");
      });
      input.addEventListener("input", () => this.#control.moveAxis(axis, Number(input.value)));
      for (const end of ["pointerup", "pointercancel", "lostpointercapture", "blur"]) {
        input.addEventListener(end, () => this.#control.release("axis"));
      }
      return { input, value: make("span", { class: "axis-value" }) };
    });
    this.replaceChildren(
      ...this.#rows.map(({ input, value }, axis) =>
        make("label", { class: "axis-row" }, make("span", {}, axes[axis]?.name ?? ""), input, value),
      ),
    );
    this.hidden = axes.length === 0;
    this.#choose(0);
  }

  /** @param {number} axis */
  #choose(axis) {
    this.#chosen = this.#rows.length === 0 ? 0 : axis % this.#rows.length;
    this.#rows.forEach(({ input }, each) => input.classList.toggle("chosen", each === this.#chosen));
  }

  /** The sliders follow what the hand wants. */
  #follow() {
    this.#rows.forEach(({ input }, axis) => {
      const target = this.#control.axisTarget(axis);
      if (target !== null) input.value = String(target);
    });
  }

  /** @param {string} key @param {1 | -1} way */
  #key(key, way) {
    /** @type {ReturnType<typeof setInterval> | undefined} */
    let timer;
    return {
      keys: [key],
      what: `with Space and more axes: move the chosen one ${way > 0 ? "up" : "down"}`,
      down: () => {
        timer = setInterval(() => {
          const target = this.#control.axisTarget(this.#chosen);
          if (target !== null) this.#control.moveAxis(this.#chosen, target + way * STEP);
        }, KEY_MS);
      },
      up: () => clearInterval(timer),
    };
  }
}

customElements.define("axis-sliders", AxisSliders);

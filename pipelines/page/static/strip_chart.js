/**
 * `<strip-chart>`: signals over the last seconds, least and greatest value a pixel column. What is
 * drawn is moved by copying the canvas; only columns that changed are drawn anew.
 */
import { fitCanvas } from "./canvas_size.js";
import { ColumnStore } from "./column_store.js";
import { startDrawing, stopDrawing } from "./drawing_loop.js";
import { make, setText } from "./make.js";
import { token, tokenGeneration } from "./tokens.js";

/**
 * @typedef {{token: string, thick: boolean}} Signal its colour's token; a thick one lies below
 *   the thin ones, so that two are told apart without colour
 * @typedef {{title: string, unit: string, least: number, signals: readonly Signal[]}} Look
 *   `least`: the chart reaches at least from minus this to plus this, in `unit`
 */

/** Beyond the newest column there may be some that late samples fill. */
const STEPS = [1, 2, 5];
/** The chart's range shrinks only when half of it stayed empty for its whole span. */
const SHRINK_BELOW = 0.4;

/** The next larger 1, 2 or 5 times a power of ten.
 * @param {number} value
 */
function nice(value) {
  const power = 10 ** Math.floor(Math.log10(value));
  const step = STEPS.find((one) => one * power >= value * 0.999);
  return step === undefined ? 10 * power : step * power;
}

export class StripChart extends HTMLElement {
  /** @type {Look} */
  look = { title: "", unit: "", least: 1, signals: [] };
  #canvas = make("canvas");
  #top = make("span", { class: "strip-top" });
  #bottom = make("span", { class: "strip-bottom" });
  #title = make("span", { class: "strip-title" });
  /** @type {ColumnStore | null} */
  #store = null;
  #context = /** @type {CanvasRenderingContext2D} */ (this.#canvas.getContext("2d"));
  #spanUs = 10e6;
  #nowUs = NaN;
  #reach = 1;
  #drawnTo = NaN;
  #generation = -1;
  #checked = 0;

  /** Called when the chart lost its columns and wants the samples of its span again.
   * @type {(chart: StripChart) => void}
   */
  onempty = () => {};

  connectedCallback() {
    if (this.childElementCount === 0) this.append(this.#title, this.#top, this.#bottom, this.#canvas);
    startDrawing(this);
  }

  disconnectedCallback() {
    stopDrawing(this);
  }

  /** The time from the left edge to the right one, µs. */
  get spanUs() {
    return this.#spanUs;
  }

  set spanUs(spanUs) {
    this.#spanUs = spanUs;
    this.#store = null;
  }

  /** Put one value in.
   * @param {number} signal index into `look.signals`
   * @param {number} timeUs
   * @param {number} value in `look.unit`
   */
  add(signal, timeUs, value) {
    this.#store?.add(signal, timeUs, value);
  }

  /** Set the instant of the right edge.
   * @param {number} nowUs
   */
  update(nowUs) {
    this.#nowUs = nowUs;
  }

  /** Bring the canvas up to date; called by the drawing loop. */
  draw() {
    if (Number.isNaN(this.#nowUs)) return;
    // Two samples a column at least: otherwise columns between samples would look like gaps.
    const fresh = fitCanvas(this.#canvas, this.#spanUs / 2000);
    const width = this.#canvas.width;
    if (width === 0) return;
    if (fresh || this.#store === null) {
      this.#store = new ColumnStore(width + 64, this.#spanUs / width, this.look.signals.length);
      this.#reach = this.look.least;
      this.onempty(this);
      this.#drawnTo = NaN;
    }
    const store = this.#store;
    const right = store.columnOf(this.#nowUs);
    let from = right - width + 1;
    const all = this.#rescaled(store, from, right) || this.#generation !== tokenGeneration();
    const shift = right - this.#drawnTo;
    if (!all && shift >= 0 && shift < width) {
      if (shift === 0 && store.changedFrom > right) return;
      if (shift > 0) this.#context.drawImage(this.#canvas, -shift, 0);
      // One column more on the left: it is joined to the one that changed.
      from = Math.max(from, Math.min(this.#drawnTo + 1, store.changedFrom + 1) - 1);
    }
    this.#columns(store, from, right);
    store.taken();
    this.#drawnTo = right;
    this.#generation = tokenGeneration();
  }

  /** Widen the range at once, narrow it when it has been too wide for long.
   * @param {ColumnStore} store
   * @param {number} from
   * @param {number} right
   */
  #rescaled(store, from, right) {
    const signals = this.look.signals.map((_, index) => index);
    const fresh = store.reach(signals, Math.max(from, Math.min(store.changedFrom, right)), right);
    let reach = this.#reach;
    if (fresh > reach) {
      reach = nice(fresh);
    } else if (right - this.#checked > store.columns / 8) {
      this.#checked = right;
      const most = store.reach(signals, from, right);
      if (most < reach * SHRINK_BELOW) reach = Math.max(this.look.least, nice(most || 1e-9));
    }
    const { title, unit } = this.look;
    setText(this.#title, title);
    setText(this.#top, `${reach} ${unit}`);
    setText(this.#bottom, `−${reach}`);
    const changed = reach !== this.#reach;
    this.#reach = reach;
    return changed;
  }

  /** Draw columns `from` to `right` on an empty ground.
   * @param {ColumnStore} store
   * @param {number} from
   * @param {number} right
   */
  #columns(store, from, right) {
    const context = this.#context;
    const { width, height } = this.#canvas;
    const left = width - 1 - (right - from);
    const middle = height / 2;
    const scale = (height / 2 - 2) / this.#reach;
    context.clearRect(left, 0, width - left, height);
    context.fillStyle = token("--line");
    context.fillRect(left, Math.round(middle), width - left, 1);
    this.#ticks(store, from, right, left);
    this.look.signals.forEach((signal, lane) => {
      const least = signal.thick ? 5 : 1.5;
      context.fillStyle = token(signal.token);
      for (let column = from, x = left; column <= right; column++, x++) {
        const place = store.placeOf(lane, column);
        if (place < 0) continue;
        let low = store.least[place];
        let high = store.greatest[place];
        const before = store.placeOf(lane, column - 1);
        if (before >= 0) {
          low = Math.min(low, store.greatest[before]);
          high = Math.max(high, store.least[before]);
        }
        const tall = Math.max(least, (high - low) * scale);
        context.fillRect(x, middle - ((high + low) * scale + tall) / 2, 1, tall);
      }
    });
  }

  /** Thin lines at whole seconds, at whole tens of them on a long span.
   * @param {ColumnStore} store
   * @param {number} from
   * @param {number} right
   * @param {number} left
   */
  #ticks(store, from, right, left) {
    const stepUs = this.#spanUs > 20e6 ? 10e6 : this.#spanUs > 5e6 ? 1e6 : 0.2e6;
    let tick = Math.ceil((from * store.columnUs) / stepUs);
    for (; ; tick++) {
      const column = store.columnOf(tick * stepUs);
      if (column > right) return;
      if (column >= from) this.#context.fillRect(left + column - from, 0, 1, this.#canvas.height);
    }
  }
}

customElements.define("strip-chart", StripChart);

/**
 * `<strip-chart>`: signals over the last seconds, least and greatest value a pixel column. What is
 * drawn is moved by copying the canvas; only columns that changed are drawn anew.
 */
import { ColumnStore } from "./column_store.js";
import { make, setText } from "./dom.js";
import { paint, themeNumber } from "./palette.js";

/**
 * colour: its design token. A thick signal lies below the thin ones, so that two are told apart
 * without colour.
 * @typedef {{colour: string, thick: boolean}} Signal
 */

/**
 * least: the chart reaches at least from minus this to plus this, in `unit`.
 * @typedef {{title: string, unit: string, least: number, signals: readonly Signal[]}} Look
 */

const STEPS = [1, 2, 5];
/** The range shrinks when less than this share of it was used over the whole span. */
const SHRINK_BELOW = 0.4;
const THICK = 5;
const THIN = 1.5;

/** The next larger 1, 2 or 5 times a power of ten.
 * @param {number} value
 */
function nice(value) {
  const power = 10 ** Math.floor(Math.log10(value));
  const step = STEPS.find((one) => one * power >= value * 0.999);
  return step === undefined ? 10 * power : step * power;
}

export class StripChart extends HTMLElement {
  #look;
  #refill;
  #canvas = make("canvas", { role: "img" });
  #context = /** @type {CanvasRenderingContext2D} */ (this.#canvas.getContext("2d"));
  #top = make("span", { class: "strip-top" });
  #bottom = make("span", { class: "strip-bottom" });
  /** @type {ColumnStore | null} */
  #store = null;
  #spanUs = 10e6;
  #reach;
  /** The canvas's box, in CSS pixels. */
  #box = { width: 0, height: 0 };
  /** The column at the right edge of what is drawn. */
  #drawnTo = NaN;
  #theme = -1;
  /** The column at which the range was last found too wide or right. */
  #checked = 0;

  /**
   * @param {Look} look
   * @param {(chart: StripChart) => void} refill Called when the chart has lost its columns: is to
   *   `add` the samples of its span again.
   */
  constructor(look, refill) {
    super();
    this.#look = look;
    this.#refill = refill;
    this.#reach = look.least;
    // To ask the canvas itself would cost a layout each time.
    new ResizeObserver(([entry]) => {
      this.#box = entry.contentRect;
    }).observe(this.#canvas);
    this.#canvas.setAttribute("aria-label", `${look.title}, ${look.unit}`);
  }

  connectedCallback() {
    const title = make("span", { class: "strip-title" }, this.#look.title);
    this.replaceChildren(title, this.#top, this.#bottom, this.#canvas);
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

  /** Bring the canvas up to date. @param {number} nowUs The instant of the right edge. */
  draw(nowUs) {
    const resized = this.#fit();
    const { width } = this.#canvas;
    if (width === 0) return;
    if (resized || this.#store === null) {
      // Some columns more than are shown: the newest samples may be ahead of `nowUs`.
      this.#store = new ColumnStore(width + 64, this.#spanUs / width, this.#look.signals.length);
      this.#reach = this.#look.least;
      this.#drawnTo = NaN;
      this.#refill(this);
    }
    const store = this.#store;
    const right = store.columnOf(nowUs);
    let from = right - width + 1;
    const all = this.#rescaled(store, from, right) || this.#theme !== themeNumber();
    const shift = right - this.#drawnTo;
    if (!all && shift >= 0 && shift < width) {
      if (shift === 0 && store.changedFrom > right) return;
      if (shift > 0) this.#move(shift);
      from = Math.max(from, Math.min(this.#drawnTo + 1, store.changedFrom));
    }
    this.#columns(store, from, right);
    store.taken();
    this.#drawnTo = right;
    this.#theme = themeNumber();
  }

  /** Move what is drawn to the left. @param {number} columns */
  #move(columns) {
    this.#context.globalCompositeOperation = "copy";
    this.#context.drawImage(this.#canvas, -columns, 0);
    this.#context.globalCompositeOperation = "source-over";
  }

  /** Fit the canvas to its box in device pixels; whether that emptied it. */
  #fit() {
    const canvas = this.#canvas;
    const { width, height } = this.#box;
    // Two samples a column at least: otherwise columns between samples would look like gaps.
    const columns = Math.min(Math.round(width * devicePixelRatio), this.#spanUs / 2000);
    const rows = Math.round(height * devicePixelRatio);
    if (canvas.width === columns && canvas.height === rows) return false;
    canvas.width = columns;
    canvas.height = rows;
    return true;
  }

  /** Widen the range at once, narrow it when it has been too wide for long.
   * @param {ColumnStore} store
   * @param {number} from
   * @param {number} right
   */
  #rescaled(store, from, right) {
    const signals = this.#look.signals.map((_, index) => index);
    const fresh = store.reach(signals, Math.max(from, Math.min(store.changedFrom, right)), right);
    let reach = this.#reach;
    if (fresh > reach) {
      reach = nice(fresh);
    } else if (right - this.#checked > store.columns / 8) {
      this.#checked = right;
      const most = store.reach(signals, from, right);
      if (most < reach * SHRINK_BELOW) reach = Math.max(this.#look.least, nice(most || 1e-9));
    }
    setText(this.#top, `${reach} ${this.#look.unit}`);
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
    context.fillStyle = paint("--line");
    context.fillRect(left, Math.round(middle), width - left, 1);
    this.#ticks(store, from, right, left);
    this.#look.signals.forEach((signal, lane) => {
      const least = signal.thick ? THICK : THIN;
      context.fillStyle = paint(signal.colour);
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

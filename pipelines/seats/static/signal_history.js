/** Whether there was signal, over the last minutes: one state for each tenth of a second. */

export const UNKNOWN = 0;
export const NO_SIGNAL = 1;
export const SIGNAL = 2;
export const CONNECTED = 3;

export const STEP_US = 100_000;

export class SignalHistory {
  /** @param {number} steps That are kept. */
  constructor(steps) {
    this.steps = steps;
    this.states = new Uint8Array(steps);
    /** The number of the newest step, counted from the clock's zero. */
    this.newest = -1;
  }

  /** Take the state at an instant. Steps between this and the one before are unknown.
   * @param {number} nowUs @param {boolean} signal @param {boolean} connected
   */
  append(nowUs, signal, connected) {
    const step = Math.floor(nowUs / STEP_US);
    if (step < this.newest) return;
    const state = connected ? CONNECTED : signal ? SIGNAL : NO_SIGNAL;
    // A state comes ten times a second; one step between two is only their jitter.
    const from = Math.max(this.newest + 1, step - this.steps + 1);
    const between = step - this.newest <= 3 ? state : UNKNOWN;
    for (let one = from; one < step; one += 1) this.states[one % this.steps] = between;
    // The worst state within a step counts: a short loss must not vanish.
    const place = step % this.steps;
    this.states[place] = step === this.newest ? Math.min(this.states[place], state) : state;
    this.newest = step;
  }

  /** The state of a step, counted back from that of `nowUs`. @param {number} nowUs @param {number} back */
  at(nowUs, back) {
    const step = Math.floor(nowUs / STEP_US) - back;
    if (step > this.newest || step <= this.newest - this.steps || step < 0) return UNKNOWN;
    return this.states[step % this.steps];
  }
}

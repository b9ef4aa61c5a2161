/**
 * Steers with a game controller (W3C Gamepad, standard mapping): by default a trigger or shoulder
 * button is the dead-man button, the left stick is the handle's place, and the motors show the force.
 *
 * @import { HandControl } from "./hand_control.js"
 * @import { PadAxis, PadControls } from "./texts.js"
 */

const LOOK_MS = 8;
/** After a longer pause an axis in rate mode would jump. */
const MOST_STEP_S = 0.05;
const PRESSED = 0.3;
const SHAKE_MS = 80;

const PLAIN = { up: -1, down: -1, dead_zone: 0, rate: false };
/** Shoulders and triggers are the dead-man button. @type {PadControls} */
const USUAL = {
  axes: [
    { ...PLAIN, name: "x", axis: 0, scale: 1 },
    { ...PLAIN, name: "y", axis: 1, scale: -1 },
  ],
  dead_man: [4, 5, 6, 7],
  stop: -1,
  hand_over: -1,
  panel: [0, 1, 2, 3],
};

/** @param {Gamepad} pad @param {number} index */
const value = (pad, index) => pad.buttons[index]?.value ?? 0;

/** Whether a dead-man button is pressed. @param {Gamepad} pad @param {PadControls | null} [mapping] */
export const holdsDeadMan = (pad, mapping) => (mapping ?? USUAL).dead_man.some((index) => value(pad, index) > PRESSED);

/** How far an axis is deflected, times its scale. @param {Gamepad} pad @param {PadAxis} row */
function deflection(pad, row) {
  const share = row.axis >= 0 ? (pad.axes[row.axis] ?? 0) : value(pad, row.up) - value(pad, row.down);
  return (row.scale * Math.sign(share) * Math.max(Math.abs(share) - row.dead_zone, 0)) / (1 - row.dead_zone);
}

/**
 * What a mapping can do beside moving axes.
 * @typedef {object} Mapped
 * @property {() => PadControls | null} mapping What the session's file says; null: the usual.
 * @property {() => readonly string[]} axes The names of the axes behind x and y.
 * @property {() => void} stop
 * @property {() => void} handOver
 */

/** @type {Mapped} */
const UNMAPPED = { mapping: () => null, axes: () => [], stop: () => undefined, handOver: () => undefined };

/** @param {HandControl} control @param {() => number} forceShare The force now, 0 to 1 of the most. @param {Mapped} [mapped] */
export function steerByController(control, forceShare, mapped = UNMAPPED) {
  /** @type {ReturnType<typeof setInterval> | undefined} */
  let timer;
  let shookMs = 0;
  let lookedMs = 0;
  /** A press that was refused counts again only after its release. */
  let pressed = false;
  /** Which of the buttons that order something are pressed. */
  const ordering = { stop: false, handOver: false };

  /** @param {Gamepad} pad @param {PadControls} mapping @param {number} seconds */
  const move = (pad, mapping, seconds) => {
    const target = { x: 0, y: 0, ...control.target };
    const axes = mapped.axes();
    for (const row of mapping.axes) {
      const share = deflection(pad, row);
      const behind = axes.indexOf(row.name);
      const at = row.name === "x" || row.name === "y" ? target[row.name] : (control.axisTarget(behind) ?? 0);
      const wanted = row.rate ? at + share * seconds : share;
      if (row.name === "x" || row.name === "y") target[row.name] = wanted;
      else if (behind >= 0) control.moveAxis(behind, wanted);
    }
    control.move("controller", target.x, target.y);
  };

  const look = () => {
    const mapping = mapped.mapping() ?? USUAL;
    const pad = navigator.getGamepads().find((one) => one !== null && one.connected) ?? null;
    const nowMs = performance.now();
    const seconds = Math.min((nowMs - lookedMs) / 1000, MOST_STEP_S);
    lookedMs = nowMs;
    for (const [order, index] of /** @type {["stop" | "handOver", number][]} */ ([["stop", mapping.stop], ["handOver", mapping.hand_over]])) {
      const now = pad !== null && value(pad, index) > PRESSED;
      if (now && !ordering[order] && document.hasFocus()) mapped[order]();
      ordering[order] = now;
    }
    const held = pad !== null && holdsDeadMan(pad, mapping);
    if (pad === null || !held) {
      if (pressed) control.release("controller");
      pressed = false;
      return;
    }
    if (!pressed) {
      pressed = true;
      // A page without the focus is told of no release.
      if (document.hasFocus()) control.press("controller");
    }
    if (control.source !== "controller") return;
    move(pad, mapping, seconds);
    control.setButtons(mapping.panel.reduce((bits, index, bit) => bits | (pad.buttons[index]?.pressed === true ? 1 << bit : 0), 0));
    if (nowMs - shookMs < SHAKE_MS) return;
    shookMs = nowMs;
    const share = Math.min(1, forceShare());
    // Both motors: the heavy one for what is strong, the light one for what is faint.
    pad.vibrationActuator
      ?.playEffect("dual-rumble", {
        duration: 1.5 * SHAKE_MS,
        strongMagnitude: share,
        weakMagnitude: Math.sqrt(share),
      })
      .catch(() => undefined);
  };

  addEventListener("gamepadconnected", () => {
    timer ??= setInterval(look, LOOK_MS);
  });
  addEventListener("gamepaddisconnected", () => {
    look();
    if (navigator.getGamepads().some((one) => one !== null)) return;
    clearInterval(timer);
    timer = undefined;
  });
}

/**
 * Steers with a game controller (W3C Gamepad, standard mapping): a trigger or shoulder button is
 * the dead-man button, the left stick is the handle's place, and the motors show the force.
 *
 * @import { HandControl } from "./hand_control.js"
 */

const LOOK_MS = 8;
/** Shoulders and triggers. */
const DEAD_MAN = [4, 5, 6, 7];
const PRESSED = 0.3;
const BUTTONS = 4;
const SHAKE_MS = 80;

/** Whether a shoulder button or trigger is pressed. @param {Gamepad} pad */
export const holdsDeadMan = (pad) => DEAD_MAN.some((index) => (pad.buttons[index]?.value ?? 0) > PRESSED);

/** @param {HandControl} control @param {() => number} forceShare The force now, 0 to 1 of the most. */
export function steerByController(control, forceShare) {
  /** @type {ReturnType<typeof setInterval> | undefined} */
  let timer;
  let shookMs = 0;
  /** A press that was refused counts again only after its release. */
  let pressed = false;

  const look = () => {
    const pad = navigator.getGamepads().find((one) => one !== null && one.connected) ?? null;
    const held = pad !== null && holdsDeadMan(pad);
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
    control.move("controller", pad.axes[0] ?? 0, -(pad.axes[1] ?? 0));
    let buttons = 0;
    for (let index = 0; index < BUTTONS; index += 1) {
      if (pad.buttons[index]?.pressed === true) buttons |= 1 << index;
    }
    control.setButtons(buttons);
    const nowMs = performance.now();
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

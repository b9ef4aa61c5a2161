/**
 * Steers with keys: Space is the dead-man button, arrows or WASD move the handle at a constant
 * speed, slower with Shift.
 *
 * @import { HandControl } from "./hand_control.js"
 * @import { Keyboard } from "./keyboard.js"
 */

const SPEED_M_S = 0.1;
const SLOW_M_S = 0.02;
const STEP_MS = 8;
/** After a longer pause the handle would jump. */
const MOST_STEP_MS = 50;

/** @type {[string, string[], number, number][]} */
const WAYS = [
  ["left", ["ArrowLeft", "KeyA"], -1, 0],
  ["right", ["ArrowRight", "KeyD"], 1, 0],
  ["up", ["ArrowUp", "KeyW"], 0, 1],
  ["down", ["ArrowDown", "KeyS"], 0, -1],
];

/** @param {Keyboard} keyboard @param {HandControl} control @param {() => {x: number, y: number}} halves The half workspace in metres. */
export function steerByKeys(keyboard, control, halves) {
  /** @type {Set<string>} */
  const held = new Set();
  let slow = false;
  /** @type {ReturnType<typeof setInterval> | undefined} */
  let timer;
  let lastMs = 0;

  const step = () => {
    const nowMs = performance.now();
    const seconds = Math.min(nowMs - lastMs, MOST_STEP_MS) / 1000;
    lastMs = nowMs;
    const target = control.target;
    if (control.source !== "keys" || target === null) return;
    const ways = WAYS.filter(([way]) => held.has(way));
    const x = ways.reduce((sum, [, , right]) => sum + right, 0);
    const y = ways.reduce((sum, [, , , up]) => sum + up, 0);
    const length = Math.hypot(x, y);
    if (length === 0) return;
    const way = ((slow ? SLOW_M_S : SPEED_M_S) * seconds) / length;
    const half = halves();
    control.move("keys", target.x + (x * way) / half.x, target.y + (y * way) / half.y);
  };

  keyboard.add(
    {
      keys: ["Space"],
      shown: "Space",
      what: "hold the handle (the dead-man button)",
      down: () => {
        if (!control.press("keys")) return;
        lastMs = performance.now();
        timer = setInterval(step, STEP_MS);
      },
      up: () => {
        clearInterval(timer);
        control.release("keys");
      },
    },
    ...WAYS.map(([way, keys]) => ({
      keys,
      shown: keys.map((key) => SHOWN[key] ?? key.replace("Key", "")).join(" "),
      what: `with Space: move ${way}`,
      down: () => void held.add(way),
      up: () => void held.delete(way),
    })),
    {
      keys: ["ShiftLeft", "ShiftRight"],
      shown: "Shift",
      what: "with these: slowly",
      down: () => {
        slow = true;
      },
      up: () => {
        slow = false;
      },
    },
  );
}

/** @type {Record<string, string>} */
const SHOWN = { ArrowLeft: "←", ArrowRight: "→", ArrowUp: "↑", ArrowDown: "↓" };

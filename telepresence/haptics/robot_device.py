"""A user's robot: the interface of its driver, and how a session drives it.

A driver says where the tip is and what pushes it, and takes a force or a place. Modes, passivity,
limits and the safety envelope stay on this side.
"""

from itertools import chain
from math import hypot, isfinite
from typing import NamedTuple, Protocol, cast

from kontur_av.errors import ConfigError
from kontur_av.media import Tip, Tips
from kontur_av.returned import PartError, fault_of, taken
from telepresence.haptics.axes import AxisReading, MoreAxes, MoreAxis, SimulatedAxis
from telepresence.haptics.robot import JointReading, Robot, RobotCapabilities
from telepresence.haptics.sample import MODE_OFF

#: The robot that the session simulates.
SIMULATED_ROBOT = "sim"
#: A robot that takes places and is further than this from the one it was given does not follow.
_LAG_M = 0.02
#: The place that a robot without a force sensor is given is never further from where it is: so it
#: presses no harder on what is in its way.
_LEASH_M = 0.015


class RobotReading(NamedTuple):
    """What a robot measures.

    x_m, y_m, vx_m_s, vy_m_s: place of the tip from the middle, and its velocity.
    push_x_n, push_y_n: the force of its surroundings on the tip.
    contact: it touches something.
    error: why it cannot go on, in one line; "" if it can.
    holds: its hand holds the ball of a task.
    joints: for telemetry; the first 7 are told.
    """

    x_m: float
    y_m: float
    vx_m_s: float
    vy_m_s: float
    push_x_n: float = 0.0
    push_y_n: float = 0.0
    contact: bool = False
    error: str = ""
    holds: bool = False
    joints: tuple[JointReading, ...] = ()


class RobotDevice(Protocol):
    """A robot's driver. No method but `configure` and `power_on` may block.

    Lifecycle: `configure`, `power_on`; then `activate` and `deactivate` as often as the session
    switches it on and off; `power_off` at the end, whatever happens. An `emergency_off`, if it has
    one, takes its power after its process hung, without `configure`. In each cycle of 1 ms:
    `write_force` or `write_position` while it is active, then `advance`, then `read`. One whose
    facts name more axes is a `MoreAxes`, too. A `tips`, if it has one, returns where cameras see
    its tip: by camera, (x, y) as shares of the picture; it is called 5 times a second.
    """

    @property
    def capabilities(self) -> RobotCapabilities:
        """What it is; asked for after `configure`."""

    def configure(self) -> None:
        """Connect to the robot. Raises ConfigError, with the fix, if that is not possible."""

    def power_on(self) -> None:
        """Give it power; it must not move."""

    def activate(self) -> None:
        """From now on it follows what is written."""

    def deactivate(self) -> None:
        """It brakes, and stays where it is, whatever was written."""

    def power_off(self) -> None:
        """Take its power; also after an error."""

    def read(self) -> RobotReading:
        """Return the newest measurement; the same one again if there is no newer."""

    def write_force(self, x_n: float, y_n: float) -> None:
        """Exert this force at the tip (N, N) until the next call, but at most for 50 ms."""

    def write_position(self, x_m: float, y_m: float, vx_m_s: float, vy_m_s: float) -> None:
        """Follow this place (m) and velocity (m/s); only of a robot that takes places."""

    def advance(self, dt_ns: int) -> None:
        """`dt_ns` pass until the next cycle; a simulated robot moves on by them."""


class _Surroundings:
    """In the place of the simulated board: what the robot's sensor measures."""

    wall_n = 0.0
    touching = False

    def __init__(self) -> None:
        self.push_n = (0.0, 0.0)

    def press(self, x_m: float, y_m: float, vx_m_s: float, vy_m_s: float) -> tuple[float, float]:
        return self.push_n


class DrivenRobot(Robot):
    """A `Robot` that is a user's. Its modes are those of the simulated one, at the tip.

    Whatever the driver returns or raises, the session goes on: it is an error of the robot.

    device: its driver.
    error: why it cannot go on; the session then switches it off.
    Raises ConfigError, without power, if it does not come up: PartError once it had power.
    """

    def __init__(self, device: RobotDevice) -> None:
        self.device = device
        self._active = self._powered = False
        self._joints: tuple[JointReading, ...] = ()
        #: Why its power could not be taken; "" if it was.
        self._stuck = ""
        self._surroundings = _Surroundings()
        call = "configure()"
        try:
            device.configure()
            call = "capabilities"
            self.capabilities = capabilities = taken(RobotCapabilities, device.capabilities, call)
            call = "power_on()"
            self._powered = True
            device.power_on()
            call = "read()"
            first = taken(RobotReading, device.read(), call)
            super().__init__(x_m=first.x_m, y_m=first.y_m)
            self._takes_positions = capabilities.takes == "position"
            self._leashed = self._takes_positions and capabilities.force == "none"
            #: As the driver has them; None without more axes.
            self._axes: MoreAxes | None = cast(MoreAxes, device) if capabilities.more else None
            if self._takes_positions:
                self.more = [SimulatedAxis(each, meets=False) for each in capabilities.more]
            else:
                self.more = [MoreAxis(each) for each in capabilities.more]
            if self._axes is not None:
                self._take_more(self._axes, stand=True)
        except Exception as error:
            words = fault_of(call, error)
            self._follow(active=False)
            self._take_power()
            kind = ConfigError if call == "configure()" else PartError
            raise kind(words + (f"; {self._stuck}" if self._stuck else "")) from error
        self._press = self._surroundings.press
        self._limit = min(capabilities.force_limit_n, self.model.force_limit_n)
        self._take(first)

    def _switch(self, mode: int, *, coupled: bool = False) -> None:
        super()._switch(mode, coupled=coupled)
        self._follow(active=mode != MODE_OFF)

    def drive(self, dt_ns: int) -> None:
        if self.mode != MODE_OFF:
            super().drive(dt_ns)
            return
        # Its own brakes hold it.
        call = "advance()"
        try:
            self.device.advance(dt_ns)
            call = "read()"
            self._take(taken(RobotReading, self.device.read(), call))
            if self._axes is not None:
                call = "read_more()"
                self._take_more(self._axes, stand=True)
        except Exception as error:
            self.error = fault_of(call, error)

    def step(self, fx_n: float, fy_n: float, dt_ns: int) -> None:
        if self._takes_positions:
            super().step(fx_n, fy_n, dt_ns)
        else:
            limit = self._limit
            fx_n, fy_n = max(-limit, min(limit, fx_n)), max(-limit, min(limit, fy_n))
        call = "write_force()"
        try:
            if self._takes_positions:
                call = "write_position()"
                self._lead()
            else:
                self._push(fx_n, fy_n)
            call = "advance()"
            self.device.advance(dt_ns)
            call = "read()"
            reading = taken(RobotReading, self.device.read(), call)
            call = "read_more()"
            if self._takes_positions:
                if self._leashed:
                    self._pull_back(reading)
                off_m = hypot(reading.x_m - self.x_m, reading.y_m - self.y_m)
                if self._feel(reading) and not off_m < _LAG_M:
                    self.error = "it does not follow the places that it is given"
            else:
                self._take(reading)
                self.work_j += (fx_n * self.vx_m_s + fy_n * self.vy_m_s) * dt_ns / 1e9
            if self._axes is not None:
                self._take_more(self._axes, stand=not self._takes_positions)
        except Exception as error:
            # The driver is the user's: whatever it raises is an error of the robot.
            self.error = fault_of(call, error)

    def _pull_back(self, reading: RobotReading) -> None:
        """Let the place that it is given wait for the robot."""
        lead_x_m, lead_y_m = self.x_m - reading.x_m, self.y_m - reading.y_m
        lead_m = hypot(lead_x_m, lead_y_m)
        if lead_m > _LEASH_M:
            share = _LEASH_M / lead_m
            self.x_m, self.y_m = reading.x_m + lead_x_m * share, reading.y_m + lead_y_m * share
            self.vx_m_s, self.vy_m_s = reading.vx_m_s, reading.vy_m_s

    def _lead(self) -> None:
        """Write the places that the virtual masses have reached."""
        self.device.write_position(self.x_m, self.y_m, self.vx_m_s, self.vy_m_s)
        if self._axes is not None:
            self._axes.write_more_positions(
                [axis.position_m / axis.lever_m for axis in self.more],
                [axis.speed_m_s / axis.lever_m for axis in self.more],
            )

    def _push(self, fx_n: float, fy_n: float) -> None:
        """Write the forces."""
        self.device.write_force(fx_n, fy_n)
        if self._axes is not None:
            brake = 0.0 if self.coupled else self.model.brake_n_s_m
            for axis in self.more:
                axis.force_n -= brake * axis.speed_m_s
            self._axes.write_more_forces([axis.cut_n * axis.lever_m for axis in self.more])

    def close(self) -> None:
        """Switch it off for good. Raises ConfigError if its power could not be taken."""
        self._follow(active=False)
        self._take_power()
        if self._stuck:
            raise ConfigError(self._stuck)

    @property
    def joints(self) -> tuple[JointReading, ...]:
        return self._joints

    def led(self) -> int | None:
        return None

    def tips(self) -> Tips:
        """Return where cameras see the tip, as far as the driver says."""
        try:
            tips = dict(getattr(self.device, "tips", dict)())
            return {str(camera): taken(Tip, tip, "tips()") for camera, tip in tips.items()}
        except Exception as error:
            self.error = fault_of("tips()", error)
            return {}

    def _follow(self, *, active: bool) -> None:
        if active is self._active:
            return
        self._active = active
        call = "activate()" if active else "deactivate()"
        try:
            if active and not self._powered:
                call = "power_on()"
                self.device.power_on()
                self._powered = True
                call = "activate()"
            (self.device.activate if active else self.device.deactivate)()
        except Exception as error:
            self.error = fault_of(call, error)
            if not active:
                # It does not brake, so it must not have power.
                self._take_power()

    def _take_power(self) -> None:
        """Take its power; `_stuck` says why that failed."""
        if not self._powered:
            return
        try:
            self.device.power_off()
            self._powered, self._stuck = False, ""
        except Exception as error:
            self._stuck = f"{fault_of('power_off()', error)}: it may still have power"
            self.error = f"{self.error}; {self._stuck}" if self.error else self._stuck

    def _take(self, reading: RobotReading) -> None:
        if self._feel(reading):
            self.x_m, self.y_m, self.vx_m_s, self.vy_m_s = reading[:4]

    def _take_more(self, axes: MoreAxes, *, stand: bool) -> None:
        """Take the measurements behind x and y; stand: also the places, else the forces only."""
        readings = taken(tuple[AxisReading, ...], axes.read_more(), "read_more()")
        for axis, reading in zip(self.more, readings, strict=True):
            position_m, speed_m_s = axis.position_m, axis.speed_m_s
            trouble = axis.take(reading)
            if not stand:
                off_m = abs(axis.position_m - position_m)
                if self._leashed and off_m > _LEASH_M:
                    lead_m = _LEASH_M if position_m > axis.position_m else -_LEASH_M
                    position_m, speed_m_s = axis.position_m + lead_m, axis.speed_m_s
                    off_m = _LEASH_M
                axis.position_m, axis.speed_m_s = position_m, speed_m_s
                if not trouble and off_m > _LAG_M:
                    trouble = (
                        f"{axis.capabilities.name} does not follow the places that it is given"
                    )
            self.error = self.error or trouble

    def _feel(self, reading: RobotReading) -> bool:
        """Take the force of the surroundings; return whether all of the reading are numbers."""
        if not all(map(isfinite, (*reading[:6], *chain(*reading.joints)))):
            self.error = "a measurement is not a number"
            return False
        self.push_x_n, self.push_y_n = self._surroundings.push_n = reading[4:6]
        self.contact = reading.contact
        self.force_n = hypot(self.push_x_n, self.push_y_n)
        self.error = reading.error
        self.holds = reading.holds
        self._joints = reading.joints
        return True

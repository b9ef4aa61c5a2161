"""Scripts: calibration and functional checks written as generators, one cycle per step.

A script yields what the device should do until the next cycle, and receives what the sensors then
measure. A movement thus reads from top to bottom, but nothing blocks. The caller decides what
drives the script: a loop at 1 kHz or virtual time.

The result of a check has figures, each with its limits.
"""

from collections.abc import Generator
from dataclasses import dataclass, field
from math import hypot, inf
from typing import Generic, NamedTuple, TypeVar

from kontur_av.clock import NS_PER_MS, NS_PER_S
from telepresence.haptics.device.device import JoystickReading

Result = TypeVar("Result")


class Output(NamedTuple):
    """A force (N, N) and LEDs for the device; prompt: what a person should do."""

    x_n: float = 0.0
    y_n: float = 0.0
    leds: int = 0
    prompt: str = ""


class Cycle(NamedTuple):
    """What the script receives: the sensors' reading at `now_ns`."""

    reading: JoystickReading
    now_ns: int


Script = Generator[Output, Cycle, Result]

IDLE = Output()


class ScriptRun(Generic[Result]):
    """A script in progress: call `handle_reading` in each cycle until `result` is set.

    result: the script's return value; None while it runs, and after `abort`.
    """

    def __init__(self, script: Script[Result]) -> None:
        self._script = script
        self._begun = False
        self._done = False
        self.result: Result | None = None

    def handle_reading(self, reading: JoystickReading, now_ns: int) -> Output:
        """Run one cycle; return what the device should do until the next one."""
        if self._done:
            return IDLE
        try:
            if not self._begun:
                self._begun = True
                next(self._script)
            return self._script.send(Cycle(reading, now_ns))
        except StopIteration as end:
            self._done = True
            self.result = end.value
            return IDLE

    def abort(self) -> None:
        """End the script without a result."""
        self._script.close()
        self._done = True


@dataclass(frozen=True, kw_only=True, slots=True)
class Servo:
    """A spring and a damper, made by the motors, with which a script moves the handle.

    Well damped for handles of 0.2 to 1 kg, and stable at 1 kHz: damping times period stays far
    below the mass. Chosen.
    """

    stiffness_n_m: float = 300.0
    damping_n_s_m: float = 20.0

    def force(self, reading: JoystickReading, x_m: float, y_m: float) -> tuple[float, float]:
        """Return the force (N, N) that pulls the handle to rest at (x_m, y_m)."""
        k, d = self.stiffness_n_m, self.damping_n_s_m
        return (
            k * (x_m - reading.x_m) - d * reading.vx_m_s,
            k * (y_m - reading.y_m) - d * reading.vy_m_s,
        )


SERVO = Servo()

#: At rest means slower than this for this long.
_REST_M_S = 0.005
_REST_NS = 40 * NS_PER_MS
#: A slower handle that is not at its target is stuck by friction.
_SLOW_M_S = 0.01
#: Growth of the additional force (N/s) that overcomes friction without a jerk.
_CREEP_N_S = 10.0
_NEAR_M = 0.002


def travel(
    cycle: Cycle,
    x_m: float,
    y_m: float,
    *,
    speed_m_s: float = 0.15,
    force_n: float = inf,
    timeout_ns: int = 3 * NS_PER_S,
) -> Script[tuple[Cycle, bool]]:
    """Move the handle to (x_m, y_m) in encoder coordinates; return whether it rests there.

    The setpoint moves at `speed_m_s`. At the end, a slowly growing force overcomes friction. The
    whole force never exceeds `force_n`.
    """
    to_x, to_y = cycle.reading.x_m, cycle.reading.y_m
    extra_x = extra_y = 0.0
    until_ns = cycle.now_ns + timeout_ns
    still_since_ns = cycle.now_ns
    last_ns = cycle.now_ns
    while cycle.now_ns < until_ns:
        reading = cycle.reading
        dt_s = (cycle.now_ns - last_ns) / NS_PER_S
        last_ns = cycle.now_ns
        speed = hypot(reading.vx_m_s, reading.vy_m_s)
        way = hypot(x_m - to_x, y_m - to_y)
        step = speed_m_s * dt_s
        if way <= step:
            to_x, to_y = x_m, y_m
            if speed < _SLOW_M_S:
                extra_x, extra_y = _at_most(
                    extra_x + _creep(x_m - reading.x_m, dt_s),
                    extra_y + _creep(y_m - reading.y_m, dt_s),
                    force_n,
                )
        else:
            to_x += (x_m - to_x) * step / way
            to_y += (y_m - to_y) * step / way
        near = abs(x_m - reading.x_m) < _NEAR_M and abs(y_m - reading.y_m) < _NEAR_M
        if not near or speed > _REST_M_S:
            still_since_ns = cycle.now_ns
        elif cycle.now_ns - still_since_ns >= _REST_NS:
            return cycle, True
        x_n, y_n = SERVO.force(reading, to_x, to_y)
        cycle = yield Output(*_at_most(x_n + extra_x, y_n + extra_y, force_n))
    return cycle, False


def push_to_stop(
    cycle: Cycle,
    direction: tuple[int, int],
    *,
    force_n: float,
    speed_m_s: float = 0.25,
) -> Script[tuple[Cycle, JoystickReading]]:
    """Push along one axis until the handle stands still; return the reading there.

    direction: (±1, 0) or (0, ±1). A damper limits the speed at the stop to about `speed_m_s`. The
    other axis is held in place. The whole force is at most `force_n`, even against a hand.
    """
    start = cycle.reading
    along_x, along_y = direction
    damper = force_n / speed_m_s
    until_ns = cycle.now_ns + 2 * NS_PER_S
    # The handle does not move at once, so standstill does not count at first.
    still_since_ns = cycle.now_ns + 2 * _REST_NS
    while cycle.now_ns < until_ns:
        reading = cycle.reading
        hold_x, hold_y = SERVO.force(reading, start.x_m, start.y_m)
        x_n = along_x * force_n - damper * reading.vx_m_s if along_x else hold_x
        y_n = along_y * force_n - damper * reading.vy_m_s if along_y else hold_y
        velocity = reading.vx_m_s if along_x else reading.vy_m_s
        if abs(velocity) > _REST_M_S:
            still_since_ns = max(still_since_ns, cycle.now_ns)
        elif cycle.now_ns - still_since_ns >= _REST_NS:
            break
        cycle = yield Output(*_at_most(x_n, y_n, force_n))
    return cycle, cycle.reading


def _at_most(x_n: float, y_n: float, force_n: float) -> tuple[float, float]:
    size = hypot(x_n, y_n)
    if size <= force_n:
        return x_n, y_n
    return x_n * force_n / size, y_n * force_n / size


def _creep(error_m: float, dt_s: float) -> float:
    if error_m > _NEAR_M / 2:
        return _CREEP_N_S * dt_s
    if error_m < -_NEAR_M / 2:
        return -_CREEP_N_S * dt_s
    return 0.0


@dataclass(frozen=True, slots=True)
class Figure:
    """One measured quantity with its limits; None means no limit on that side.

    value: None if it could not be measured. That counts as failed if there is a limit.
    """

    name: str
    value: float | None
    unit: str = ""
    least: float | None = None
    most: float | None = None

    @property
    def passed(self) -> bool:
        """Whether the value is within its limits."""
        if self.value is None:
            return self.least is None and self.most is None
        above = self.least is None or self.value >= self.least
        return above and (self.most is None or self.value <= self.most)


@dataclass(frozen=True, slots=True)
class CheckResult:
    """Result of one functional check.

    trouble: one line that says why the check ended early; "" if it was completed.
    skipped: one line that says what the device lacks. A skipped check neither passed nor failed.
    """

    name: str
    metrics: tuple[Figure, ...] = field(default=())
    trouble: str = ""
    skipped: str = ""

    @property
    def passed(self) -> bool:
        """Whether every figure is within its limits and there was no trouble."""
        return not self.skipped and not self.trouble and all(f.passed for f in self.metrics)

    @property
    def failed(self) -> bool:
        """Whether the check was done and did not pass."""
        return not self.skipped and not self.passed


CheckScript = Script[CheckResult]

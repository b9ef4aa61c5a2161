"""Whether a user's robot does what a session will ask of it: `kontur-av robot check`."""

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from math import hypot, isfinite

import numpy as np

from kontur_av.clock import NS_PER_MS, NS_PER_S, Clock
from telepresence.haptics.device.check import CheckResult, Figure
from telepresence.haptics.robot_device import RobotDevice, RobotReading

#: Of a cycle of 1 ms, the rest is the session's.
_MOST_CYCLE_MS = 0.5
#: A robot that is still moves slower than this (m/s), and by less than this (m).
_STILL_M_S, _STILL_M = 0.005, 0.002
#: After an order to stop it comes to rest within this.
_STOP_NS = 200 * NS_PER_MS
#: A robot that runs alone stops after so long without a cycle.
_ALONE_NS = 50 * NS_PER_MS
#: A push or a way that a check asks for, as a part of what the robot can do.
_GENTLE = 0.1
_SPELL_NS = 300 * NS_PER_MS


class RobotCheck:
    """Runs the checks of one robot; each is a method, and `run` yields their results.

    The robot moves by a few centimetres. clock: paces the cycles, and times the calls.
    """

    def __init__(self, device: RobotDevice, clock: Clock) -> None:
        self._device, self._clock = device, clock
        self._calls_ns: list[int] = []
        self._readings: list[RobotReading] = []
        #: When each was read.
        self._read_ns: list[int] = []
        #: Of the forces that were written: work on the robot (J), least and now.
        self._work_j = 0.0

    def run(self) -> Iterator[CheckResult]:
        """Switch on, check, switch off; yield a result for each check."""
        device = self._device
        device.configure()
        device.power_on()
        try:
            yield self._check("power on", self.power_on)
            yield self._check("moves", self.moves)
            yield self._check("stops", self.stops)
            yield self._check("missed cycles", self.missed_cycles)
            if device.facts.runs_alone:
                yield self._check("silence", self.silence)
            yield self._check("readings", self.readings)
            yield self._check("cycle time", self.cycle_time)
        finally:
            device.deactivate()
            device.power_off()

    def power_on(self) -> tuple[Figure, ...]:
        """It stands still though it has power."""
        return self._still(self._cycles(_SPELL_NS, None))

    def moves(self) -> tuple[Figure, ...]:
        """It moves where it is pushed, or led, and gives no more than it got."""
        facts = self._device.facts
        with self._active():
            began = self._device.read()
            self._work_j = 0.0
            if facts.takes == "force":
                force_n = _GENTLE * facts.force_limit_n
                pushed = self._cycles(_SPELL_NS // 3, lambda _: (force_n, 0.0))
                braked = self._cycles(2 * _SPELL_NS, self._brake)
            else:
                way_m = _GENTLE * facts.half_width_m
                pushed = self._cycles(2 * _SPELL_NS, lambda share: (way_m * share, 0.0))
                braked = []
        way_m = max(one.x_m for one in pushed) - began.x_m
        side_m = max(abs(one.y_m - began.y_m) for one in pushed)
        figures = (
            Figure("way along x", way_m * 1e3, "mm", least=0.5),
            Figure("way aside", side_m * 1e3, "mm", most=max(1.0, way_m * 500)),
        )
        if not braked:
            return figures
        # What it took from the surroundings counts; what it kept as motion does not.
        return (*figures, Figure("energy put in", self._work_j, "J", least=-1e-3))

    def stops(self) -> tuple[Figure, ...]:
        """Switched off in motion, it comes to rest and stays, whatever is written."""
        with self._active():
            self._cycles(_SPELL_NS // 3, self._gentle)
        self._cycles(_STOP_NS, None)
        return self._still(self._cycles(_SPELL_NS, self._gentle, active=False))

    def missed_cycles(self) -> tuple[Figure, ...]:
        """A session that is late by 50 ms does not make it run away."""
        facts = self._device.facts
        with self._active():
            self._cycles(_SPELL_NS // 3, self._gentle)
            late = self._cycles(50 * NS_PER_MS, None)
        fastest = max(hypot(one.vx_m_s, one.vy_m_s) for one in late)
        return (Figure("speed", fastest, "m/s", most=facts.speed_m_s),)

    def silence(self) -> tuple[Figure, ...]:
        """Hearing nothing at all, it comes to rest by itself."""
        with self._active():
            self._cycles(_SPELL_NS // 6, self._gentle)
            self._clock.sleep_until_ns(self._clock.now_ns() + _ALONE_NS + _STOP_NS)
            known = len(self._readings)
            # The first answers are of before, so its place jumps.
            last = self._cycles(_SPELL_NS // 15, lambda _: (0.0, 0.0))[-1]
            del self._readings[known:], self._read_ns[known:]
        speed = hypot(last.vx_m_s, last.vy_m_s)
        return (Figure("speed", speed, "m/s", most=_STILL_M_S),)

    def readings(self) -> tuple[Figure, ...]:
        """All measurements are numbers, follow one from the other, and name no error."""
        facts, readings = self._device.facts, self._readings
        wrong = sum(not all(map(isfinite, one[:6])) for one in readings)
        errors = sum(bool(one.error) for one in readings)
        return (
            Figure("not numbers", wrong, most=0),
            Figure("with an error", errors, most=0),
            Figure("steps of the place", self._fastest_step(), "m/s", most=2 * facts.speed_m_s),
        )

    def cycle_time(self) -> tuple[Figure, ...]:
        """Its calls leave room for the session's own work."""
        longest = float(np.percentile(self._calls_ns, 99.9)) / NS_PER_MS
        return (Figure("its calls in a cycle, p99.9", longest, "ms", most=_MOST_CYCLE_MS),)

    def _check(self, name: str, check: Callable[[], tuple[Figure, ...]]) -> CheckResult:
        try:
            return CheckResult(name, check())
        except Exception as error:
            # The driver is the user's: whatever it raises is a finding.
            return CheckResult(name, trouble=f"{type(error).__name__}: {error}")

    @contextmanager
    def _active(self) -> Iterator[None]:
        self._device.activate()
        try:
            yield
        finally:
            self._device.deactivate()

    def _gentle(self, share: float) -> tuple[float, float]:
        facts = self._device.facts
        if facts.takes == "force":
            return _GENTLE * facts.force_limit_n, 0.0
        return _GENTLE * facts.half_width_m * share, 0.0

    def _brake(self, _share: float) -> tuple[float, float]:
        """A force against the motion."""
        last, most = self._readings[-1], _GENTLE * self._device.facts.force_limit_n
        force_x, force_y = -20.0 * last.vx_m_s, -20.0 * last.vy_m_s
        return max(-most, min(most, force_x)), max(-most, min(most, force_y))

    def _fastest_step(self) -> float:
        """The largest step of the place in a cycle, as a velocity (m/s)."""
        places = np.array([one.x_m for one in self._readings])
        lasted_ns = np.full(len(places), NS_PER_MS)
        if self._device.facts.runs_alone:
            # It went on while this program was late, and its answer may be of the cycle before.
            read_ns = np.array(self._read_ns)
            lasted_ns[2:] = np.maximum(read_ns[2:] - read_ns[:-2], NS_PER_MS)
        steps = np.abs(np.diff(places)) * NS_PER_S / lasted_ns[1:]
        return float(np.nanmax(steps, initial=0.0))

    def _still(self, readings: list[RobotReading]) -> tuple[Figure, ...]:
        first = readings[0]
        way = max(hypot(one.x_m - first.x_m, one.y_m - first.y_m) for one in readings)
        speed = max(hypot(one.vx_m_s, one.vy_m_s) for one in readings)
        return (
            Figure("way", way * 1e3, "mm", most=_STILL_M * 1e3),
            Figure("speed", speed, "m/s", most=_STILL_M_S),
        )

    def _cycles(
        self,
        lasts_ns: int,
        order: Callable[[float], tuple[float, float]] | None,
        *,
        active: bool = True,
    ) -> list[RobotReading]:
        """Run cycles of 1 ms; return their readings.

        order: what to write, given the share of the time that has passed: a force, or a place from
        where the robot was. None: nothing is written.
        """
        device, clock = self._device, self._clock
        takes_force = device.facts.takes == "force"
        began = device.read()
        last, readings = began, []
        due_ns = clock.now_ns()
        count = lasts_ns // NS_PER_MS
        for cycle in range(count):
            due_ns += NS_PER_MS
            clock.sleep_until_ns(due_ns)
            wanted = None if order is None else order((cycle + 1) / count)
            begin_ns = clock.now_ns()
            if wanted is not None and takes_force:
                device.write_force(*wanted)
            elif wanted is not None:
                x_m, y_m = began.x_m + wanted[0], began.y_m + wanted[1]
                device.write_position(x_m, y_m, 0.0, 0.0)
            device.advance(NS_PER_MS)
            last = device.read()
            read_ns = clock.now_ns()
            self._calls_ns.append(read_ns - begin_ns)
            self._read_ns.append(read_ns)
            readings.append(last)
            if wanted is not None and takes_force and active:
                pushed = wanted[0] + last.push_x_n, wanted[1] + last.push_y_n
                power_w = pushed[0] * last.vx_m_s + pushed[1] * last.vy_m_s
                self._work_j += power_w * NS_PER_MS / NS_PER_S
        self._readings += readings
        return readings

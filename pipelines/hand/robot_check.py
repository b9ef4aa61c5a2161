"""Whether a user's robot does what a session will ask of it: `kontur-av robot check`."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import cast

from kontur_av.clock import NS_PER_MS, Clock
from pipelines.hand.device_check import (
    GENTLE,
    SPELL_NS,
    STILL_M_S,
    Check,
    DeviceCheck,
    Order,
    RobotAxis,
    along,
    more_axes_of,
    speed,
)
from telepresence.haptics.axes import MoreAxes
from telepresence.haptics.device.script import Figure
from telepresence.haptics.robot import RobotFacts
from telepresence.haptics.robot_device import RobotDevice, RobotReading

#: After an order to stop it comes to rest within this.
_STOP_NS = 200 * NS_PER_MS
#: A robot that runs alone stops after this long without a cycle.
_ALONE_NS = 50 * NS_PER_MS
#: The call of `deactivate` may take this long; the loop waits for it.
_MOST_CALL_MS = 1.0


class RobotCheck(DeviceCheck[RobotReading]):
    """The checks of one robot. It moves by a few centimetres."""

    def __init__(self, device: RobotDevice, clock: Clock) -> None:
        super().__init__(RobotFacts, clock)
        self._device = device
        self._takes_force = self._powered = False
        self._deactivations_ns: list[int] = []
        #: Where the axes behind x and y were when it was activated, and stay.
        self._places: list[float] = []

    def power_on(self) -> tuple[Figure, ...]:
        """It stands still though it has power."""
        return self._still(self._cycles(SPELL_NS, None))

    def stops(self) -> tuple[Figure, ...]:
        """Switched off in motion, it comes to rest and stays, whatever is written."""
        with self._activated():
            self._cycles(SPELL_NS // 3, self._gentle(0))
        self._cycles(_STOP_NS, None)
        return self._still(self._cycles(SPELL_NS, self._gentle(0)))

    def emergency_stop(self) -> tuple[Figure, ...]:
        """Switched off in motion, it slows down from the next cycle on."""
        with self._activated():
            pushed = self._cycles(SPELL_NS // 3, self._gentle(1))
        slows = self._slows(pushed, self._cycles(_STOP_NS, None))
        # The shortest: a longer one may be the machine's.
        call_ms = min(self._deactivations_ns) / NS_PER_MS
        return slows, Figure("deactivate", call_ms, "ms", most=_MOST_CALL_MS)

    def missed_cycles(self) -> tuple[Figure, ...]:
        """A session that is late by 50 ms does not make it run away."""
        with self._activated():
            self._cycles(SPELL_NS // 3, self._gentle(0))
            late = self._cycles(50 * NS_PER_MS, None)
        fastest = max(map(speed, late))
        return (Figure("speed", fastest, "m/s", most=self._device.facts.speed_m_s),)

    def silence(self) -> tuple[Figure, ...]:
        """Hearing nothing at all, it comes to rest by itself."""
        known, step_m_s = len(self._readings), self._step_m_s
        with self._activated():
            self._cycles(SPELL_NS // 6, self._gentle(1))
            self._clock.sleep_until_ns(self._clock.now_ns() + _ALONE_NS + _STOP_NS)
            after = self._cycles(SPELL_NS // 15, lambda _: (0.0, 0.0))
        # Its first answers were of before, and then a wall may push it: it rested in between.
        del self._readings[known:]
        self._step_m_s = step_m_s
        return (Figure("least speed", min(map(speed, after)), "m/s", most=STILL_M_S),)

    def readings(self) -> tuple[Figure, ...]:
        """All measurements are numbers, follow one from the other, and name no error."""
        errors = sum(bool(one.error) for one in self._readings)
        most = 2 * self._device.facts.speed_m_s
        return (
            *self._number_figures([one[:6] for one in self._readings]),
            Figure("with an error", errors, most=0),
            Figure("steps", self._step_m_s, "m/s", most=most),
        )

    def power_off(self) -> tuple[Figure, ...]:
        """Without power it comes to rest. It need not answer any more."""
        self._device.activate()
        self._cycles(SPELL_NS // 3, self._gentle(1))
        self._switch_off()
        try:
            self._cycles(_STOP_NS, None)
            after = self._cycles(SPELL_NS, None)
        except Exception:
            return ()
        return self._still(after)

    def _switch_on(self) -> RobotFacts:
        device = self._device
        device.configure()
        self._takes_force = device.facts.takes == "force"
        self._runs_alone = device.facts.runs_alone
        device.power_on()
        self._powered = True
        return device.facts

    def _switch_off(self) -> None:
        if self._powered:
            self._powered = False
            self._device.power_off()

    def _checks(self) -> Sequence[Check]:
        no_port = "" if self._takes_force else "it takes places: no force passes its port"
        return (
            ("power on", self.power_on, ""),
            ("moves", self.moves, ""),
            ("passivity", self.passivity, no_port),
            ("stops", self.stops, ""),
            ("emergency stop", self.emergency_stop, ""),
            ("missed cycles", self.missed_cycles, ""),
            ("silence", self.silence, "" if self._runs_alone else "it moves in its cycles only"),
            ("readings", self.readings, ""),
            *self._axes_checks(),
            ("cycle time", self.cycle_time, ""),
            ("power off", self.power_off, ""),
        )

    def _axes_checks(self) -> Iterator[Check]:
        for index in more_axes_of(self._device.facts):
            view = RobotAxis(self._device, index)
            yield from self._of_axis(RobotCheck(view, self._clock), view.axis)

    @contextmanager
    def _activated(self) -> Iterator[None]:
        if self._device.facts.more:
            self._places = [one.place for one in cast(MoreAxes, self._device).read_more()]
        self._device.activate()
        try:
            yield
        finally:
            began_ns = self._clock.now_ns()
            self._device.deactivate()
            self._deactivations_ns.append(self._clock.now_ns() - began_ns)

    def _gentle(self, axis: int) -> Order:
        facts = self._device.facts
        if self._takes_force:
            return lambda _: along(axis, GENTLE * facts.force_limit_n)
        half_m = facts.half_height_m if axis else facts.half_width_m
        return lambda share: along(axis, GENTLE * half_m * share)

    def _push(self, axis: int) -> list[RobotReading]:
        with self._activated():
            if not self._takes_force:
                return self._cycles(2 * SPELL_NS, self._gentle(axis))
            pushed = self._cycles(SPELL_NS // 3, self._gentle(axis))
            self._brake(2 * SPELL_NS, self._device.facts.force_limit_n)
        return pushed

    def _read(self) -> RobotReading:
        return self._device.read()

    def _cycle(self, wanted: tuple[float, float] | None, began: RobotReading) -> RobotReading:
        device = self._device
        if wanted is not None and self._takes_force:
            device.write_force(*wanted)
        elif wanted is not None:
            device.write_position(began.x_m + wanted[0], began.y_m + wanted[1], 0.0, 0.0)
        if wanted is not None and device.facts.more:
            axes, none = cast(MoreAxes, device), [0.0] * len(device.facts.more)
            if self._takes_force:
                axes.write_more_forces(none)
            else:
                axes.write_more_positions(self._places, none)
        device.advance(NS_PER_MS)
        return device.read()

    def _power_w(self, wanted: tuple[float, float], reading: RobotReading) -> float:
        pushed = wanted[0] + reading.push_x_n, wanted[1] + reading.push_y_n
        return super()._power_w(pushed, reading)

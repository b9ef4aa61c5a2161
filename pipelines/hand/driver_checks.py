"""Whether a user's joystick or robot does what a session will ask of it.

`kontur-av joystick check` and `kontur-av robot check` run these checks.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from math import sqrt
from statistics import median
from typing import cast

import numpy as np

from kontur_av.clock import NS_PER_MS, NS_PER_S, Clock
from kontur_av.returned import taken
from pipelines.hand.device_check import (
    GENTLE,
    SPELL_NS,
    STILL_M,
    STILL_M_S,
    Check,
    DeviceCheck,
    JoystickAxis,
    Order,
    RobotAxis,
    along,
    speed,
)
from telepresence.haptics.axes import MoreAxes
from telepresence.haptics.device.checks import CheckBench
from telepresence.haptics.device.device import (
    KEEPS_FORCE_NS,
    JoystickCapabilities,
    JoystickDevice,
    JoystickReading,
)
from telepresence.haptics.device.script import Figure
from telepresence.haptics.device.states import JoystickState
from telepresence.haptics.device.supervision import MOST_NOISE_UM, Limits
from telepresence.haptics.robot import LEAST_FORCE_HZ, RobotCapabilities
from telepresence.haptics.robot_device import RobotDevice, RobotReading
from telepresence.haptics.schedule import PeriodicSchedule

#: After an order to stop it comes to rest within this.
_STOP_NS = 200 * NS_PER_MS
#: A robot that runs alone stops after this long without a cycle.
_ALONE_NS = 50 * NS_PER_MS
#: The call of `deactivate` may take this long; the loop waits for it.
_MOST_CALL_MS = 1.0


class RobotCheck(DeviceCheck[RobotReading]):
    """The checks of one robot. It moves by a few centimetres."""

    _known, _view = RobotCapabilities, RobotAxis
    _device: RobotDevice

    def __init__(
        self, device: RobotDevice, clock: Clock, axes: Sequence[str] | None = None
    ) -> None:
        super().__init__(device, clock, axes)
        self._takes_force = self._felt = self._powered = False
        self._deactivations_ns: list[int] = []
        #: Where the axes behind x and y were when it was activated, and stay.
        self._positions: list[float] = []

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
        """A session that is late by 50 ms does not make it run away, nor keep its force."""
        with self._activated():
            self._cycles(SPELL_NS // 3, self._gentle(1))
            late = self._cycles(KEEPS_FORCE_NS, None)
            after = self._cycles(SPELL_NS // 6, None)
        fastest = max(map(speed, late + after))
        figure = Figure("speed", fastest, "m/s", most=self._device.capabilities.speed_m_s)
        # Of one that runs alone, `silence` tells.
        keeps = self._takes_force and not self._runs_alone
        return (figure, self._slows(late, after)) if keeps else (figure,)

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
        """All measurements are numbers, and follow one from the other."""
        most = 2 * self._device.capabilities.speed_m_s
        least_hz = LEAST_FORCE_HZ if self._felt else None
        same_ms = median(self._same_ms or [1])
        return (
            Figure("measured anew", 1000 / same_ms, "Hz", least=least_hz),
            *self._number_metrics([reading[:6] for reading in self._readings]),
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

    def _switch_on(self) -> RobotCapabilities:
        device = self._device
        device.configure()
        if not isinstance(device.capabilities, RobotCapabilities):
            # Refused here, before it has power; wrong values are the check of its facts.
            taken(RobotCapabilities, device.capabilities, "capabilities")
        self._takes_force = device.capabilities.takes == "force"
        self._felt = self._takes_force and device.capabilities.force == "felt"
        self._runs_alone = device.capabilities.runs_alone
        self._powered = True
        device.power_on()
        return device.capabilities

    def _switch_off(self) -> None:
        if self._powered:
            self._powered = False
            self._device.power_off()

    def _checks(self) -> Sequence[Check]:
        places = "it takes places: no force passes its port"
        no_port = "" if self._felt else "nobody feels its force" if self._takes_force else places
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
            ("errors", self.errors, ""),
            ("power off", self.power_off, ""),
        )

    @contextmanager
    def _activated(self) -> Iterator[None]:
        if self._device.capabilities.more:
            self._positions = [one.position for one in cast(MoreAxes, self._device).read_more()]
        self._device.activate()
        try:
            yield
        finally:
            began_ns = self._clock.now_ns()
            self._device.deactivate()
            self._deactivations_ns.append(self._clock.now_ns() - began_ns)

    def _gentle(self, axis: int) -> Order:
        capabilities = self._device.capabilities
        if self._takes_force:
            return lambda _: along(axis, GENTLE * capabilities.force_limit_n)
        half_m = capabilities.half_height_m if axis else capabilities.half_width_m
        return lambda share: along(axis, GENTLE * half_m * share)

    def _push(self, axis: int) -> list[RobotReading]:
        with self._activated():
            if not self._takes_force:
                return self._cycles(2 * SPELL_NS, self._gentle(axis))
            pushed = self._cycles(SPELL_NS // 3, self._gentle(axis))
            self._brake(2 * SPELL_NS, self._device.capabilities.force_limit_n)
        return pushed

    def _read(self) -> RobotReading:
        return taken(RobotReading, self._device.read(), "read()")

    def _cycle(self, wanted: tuple[float, float] | None, began: RobotReading) -> RobotReading:
        device = self._device
        if wanted is not None and self._takes_force:
            device.write_force(*wanted)
        elif wanted is not None:
            device.write_position(began.x_m + wanted[0], began.y_m + wanted[1], 0.0, 0.0)
        if wanted is not None and device.capabilities.more:
            axes, none = cast(MoreAxes, device), [0.0] * len(device.capabilities.more)
            if self._takes_force:
                axes.write_more_forces(none)
            else:
                axes.write_more_positions(self._positions, none)
        device.advance(NS_PER_MS)
        return self._read()

    def _power_w(self, wanted: tuple[float, float], reading: RobotReading) -> float:
        pushed = wanted[0] + reading.push_x_n, wanted[1] + reading.push_y_n
        return super()._power_w(pushed, reading)


#: The whole force is exerted this long, so that the handle stays slow.
_WHOLE_NS = 10 * NS_PER_MS
_REST = (0.0, 0.0)


class JoystickCheck(DeviceCheck[JoystickReading]):
    """The checks of one joystick, with hands off. It moves by a few centimetres."""

    _known, _view = JoystickCapabilities, JoystickAxis
    _device: JoystickDevice

    def __init__(self, device: JoystickDevice, clock: Clock) -> None:
        super().__init__(device, clock)
        self._limit_n = device.capabilities.force_limit_n
        self._open = False
        #: Each push goes back where the one before came from.
        self._way = 1.0

    def rest(self) -> tuple[Figure, ...]:
        """Without a force it stands still, and its sensors do not tremble."""
        readings = self._cycles(SPELL_NS, lambda _: _REST)
        steps = np.diff([(one.x_m, one.y_m) for one in readings], axis=0)
        noise = Figure("noise", float(np.nanstd(steps)) / sqrt(2) * 1e6, "µm", most=MOST_NOISE_UM)
        return (*self._still(readings), noise)

    def zero(self) -> tuple[Figure, ...]:
        """It counts from the middle that it was told."""
        reading = self._device.read()
        self._device.set_zero(reading.x_m, reading.y_m)
        after = self._device.read()
        far = max(abs(after.x_m), abs(after.y_m))
        return (Figure("reads there", far * 1e3, "mm", most=STILL_M * 1e3),)

    def limits(self) -> tuple[Figure, ...]:
        """A force beyond its limit is cut to that."""
        gained = []
        for size in (1.0, 2.0):
            begin = speed(self._device.read())
            pushed = self._cycles(_WHOLE_NS, self._force(0, size))
            gained.append(max(map(speed, pushed)) - begin)
            self._brake(SPELL_NS, self._limit_n)
        own, twice = gained
        return (
            Figure("by its limit", own, "m/s"),
            Figure("by twice its limit", twice, "m/s", most=1.2 * own + STILL_M_S),
        )

    def halt(self) -> tuple[Figure, ...]:
        """With no force wanted it has none from the next cycle on."""
        pushed = self._cycles(SPELL_NS // 3, self._force(1, GENTLE))
        self._device.show_state(JoystickState.HALTED)
        slows = self._slows(pushed, self._cycles(SPELL_NS // 3, lambda _: _REST))
        self._brake(SPELL_NS, self._limit_n)
        return (slows,)

    def missed_cycles(self) -> tuple[Figure, ...]:
        """A session that is late by 50 ms leaves no force in the motors."""
        self._cycles(SPELL_NS // 6, self._force(0, GENTLE))
        late = self._cycles(KEEPS_FORCE_NS, None)
        slows = self._slows(late, self._cycles(SPELL_NS // 6, None))
        self._brake(SPELL_NS, self._limit_n)
        return (slows,)

    def readings(self) -> tuple[Figure, ...]:
        """All measurements are numbers and follow one from the other; the device is there."""
        gone = sum(not reading.present for reading in self._readings)
        most = Limits().speed_m_s
        return (
            *self._number_metrics([(*one[:4], one.temperature_c or 0.0) for one in self._readings]),
            Figure("not present", gone, most=0),
            Figure("steps", self._step_m_s, "m/s", most=most),
        )

    def dead_man(self) -> tuple[Figure, ...]:
        """No button is pressed by itself."""
        held = sum(bool(reading.dead_man) for reading in self._readings)
        buttons = sum(reading.buttons != 0 for reading in self._readings)
        return (Figure("pressed", held, most=0), Figure("other buttons", buttons, most=0))

    def unplugged(self) -> tuple[Figure, ...]:
        """Closed, it has no force, and says that it is gone, as without its plug."""
        pushed = []
        if self._device.capabilities.has_force:
            pushed = self._cycles(SPELL_NS // 6, self._force(1, GENTLE))
        self._switch_off()
        after = self._cycles(SPELL_NS // 3, None)
        there = sum(one.present for one in after)
        present = Figure("present", there, most=0)
        return (present, self._slows(pushed, after)) if pushed else (present,)

    def _switch_on(self) -> JoystickCapabilities:
        self._open = True
        self._device.show_state(JoystickState.STANDBY)
        self._device.write_leds(0)
        return self._device.capabilities

    def _switch_off(self) -> None:
        if self._open:
            self._open = False
            self._device.close()

    def _checks(self) -> Sequence[Check]:
        no_motors = "" if self._device.capabilities.has_force else "it has no motors"
        return (
            ("rest", self.rest, ""),
            ("moves", self.moves, no_motors),
            ("passivity", self.passivity, no_motors),
            ("zero", self.zero, ""),
            ("limits", self.limits, no_motors),
            ("halt", self.halt, no_motors),
            ("missed cycles", self.missed_cycles, no_motors),
            ("readings", self.readings, ""),
            *self._axes_checks(),
            ("dead-man button", self.dead_man, ""),
            ("cycle time", self.cycle_time, ""),
            ("errors", self.errors, ""),
            ("unplugged", self.unplugged, ""),
        )

    def _force(self, axis: int, size: float) -> Order:
        """A share of its force along an axis, to and fro from one call to the next."""
        force = along(axis, size * self._limit_n * self._way)
        self._way = -self._way
        return lambda _: force

    def _push(self, axis: int) -> list[JoystickReading]:
        self._way = 1.0
        pushed = self._cycles(SPELL_NS // 3, self._force(axis, GENTLE))
        self._brake(2 * SPELL_NS, self._limit_n)
        return pushed

    def _read(self) -> JoystickReading:
        return taken(JoystickReading, self._device.read(), "read()")

    def _cycle(self, wanted: tuple[float, float] | None, began: JoystickReading) -> JoystickReading:
        device = self._device
        if wanted is not None:
            device.write_force(*wanted)
            if more := device.capabilities.more:
                cast(MoreAxes, device).write_more_forces([0.0] * len(more))
        device.advance(NS_PER_MS)
        return self._read()


_CYCLE_NS = NS_PER_MS
#: The longest time for all checks.
_LONGEST_NS = 300 * NS_PER_S


def run_virtually(bench: CheckBench) -> float:
    """Run until all is done, or for 5 minutes. Return the seconds of virtual time."""
    now_ns = 0
    while not bench.done and now_ns < _LONGEST_NS:
        now_ns += _CYCLE_NS
        bench.handle_cycle(now_ns, _CYCLE_NS)
    return now_ns / NS_PER_S


def run_live(
    bench: CheckBench, clock: Clock, stopped: Callable[[], bool], ask: Callable[[str], None]
) -> float:
    """Run until all is done or `stopped`, or for 5 minutes. Return the seconds.

    ask: is told what a person should do now.
    """
    began_ns = now_ns = clock.now_ns()
    schedule = PeriodicSchedule(start_ns=began_ns, period_ns=_CYCLE_NS)
    prompt = ""
    while not bench.done and not stopped() and now_ns - began_ns < _LONGEST_NS:
        clock.sleep_until_ns(schedule.next_deadline_ns)
        now_ns = clock.now_ns()
        if schedule.handle_wakeup(now_ns) < 0:
            continue
        bench.handle_cycle(now_ns, schedule.advance_ns)
        if bench.prompt != prompt:
            prompt = bench.prompt
            if prompt:
                ask(prompt)
    return (now_ns - began_ns) / NS_PER_S

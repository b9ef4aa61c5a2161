"""Whether a user's joystick does what a session will ask of it: `kontur-av joystick check`."""

from collections.abc import Callable, Iterator, Sequence
from typing import cast

from kontur_av.clock import NS_PER_MS, NS_PER_S, Clock
from pipelines.hand.device_check import (
    GENTLE,
    SPELL_NS,
    STILL_M,
    STILL_M_S,
    Check,
    DeviceCheck,
    JoystickAxis,
    Order,
    along,
    more_axes_of,
    speed,
)
from telepresence.haptics.axes import MoreAxes
from telepresence.haptics.device.checks import CheckBench
from telepresence.haptics.device.device import (
    KEEPS_FORCE_NS,
    JoystickDevice,
    JoystickFacts,
    JoystickReading,
)
from telepresence.haptics.device.script import Figure
from telepresence.haptics.device.states import JoystickState
from telepresence.haptics.device.supervision import Limits
from telepresence.haptics.schedule import PeriodicSchedule

#: The whole force is exerted this long, so that the handle stays slow.
_WHOLE_NS = 10 * NS_PER_MS
_REST = (0.0, 0.0)


class JoystickCheck(DeviceCheck[JoystickReading]):
    """The checks of one joystick, with hands off. It moves by a few centimetres."""

    def __init__(self, device: JoystickDevice, clock: Clock) -> None:
        super().__init__(JoystickFacts, clock)
        self._device = device
        self._limit_n = device.facts.force_limit_n
        self._open = False
        #: Each push goes back where the one before came from.
        self._way = 1.0

    def rest(self) -> tuple[Figure, ...]:
        """Without a force it stands still."""
        return self._still(self._cycles(SPELL_NS, lambda _: _REST))

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
        gone = sum(not one.present for one in self._readings)
        most = Limits().speed_m_s
        return (
            *self._number_figures([(*one[:4], one.temperature_c or 0.0) for one in self._readings]),
            Figure("not present", gone, most=0),
            Figure("steps", self._step_m_s, "m/s", most=most),
        )

    def dead_man(self) -> tuple[Figure, ...]:
        """No button is pressed by itself."""
        held = sum(bool(one.dead_man) for one in self._readings)
        buttons = sum(one.buttons != 0 for one in self._readings)
        return (Figure("pressed", held, most=0), Figure("other buttons", buttons, most=0))

    def unplugged(self) -> tuple[Figure, ...]:
        """Closed, it has no force, and says that it is gone, as without its plug."""
        pushed = []
        if self._device.facts.has_force:
            pushed = self._cycles(SPELL_NS // 6, self._force(1, GENTLE))
        self._switch_off()
        after = self._cycles(SPELL_NS // 3, None)
        there = sum(one.present for one in after)
        present = Figure("present", there, most=0)
        return (present, self._slows(pushed, after)) if pushed else (present,)

    def _switch_on(self) -> JoystickFacts:
        self._open = True
        self._device.show_state(JoystickState.STANDBY)
        self._device.write_leds(0)
        return self._device.facts

    def _switch_off(self) -> None:
        if self._open:
            self._open = False
            self._device.close()

    def _checks(self) -> Sequence[Check]:
        no_motors = "" if self._device.facts.has_force else "it has no motors"
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
            ("unplugged", self.unplugged, ""),
        )

    def _axes_checks(self) -> Iterator[Check]:
        for index in more_axes_of(self._device.facts):
            view = JoystickAxis(self._device, index)
            yield from self._of_axis(JoystickCheck(view, self._clock), view.axis)

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
        return self._device.read()

    def _cycle(self, wanted: tuple[float, float] | None, began: JoystickReading) -> JoystickReading:
        device = self._device
        if wanted is not None:
            device.write_force(*wanted)
            if more := device.facts.more:
                cast(MoreAxes, device).write_more_forces([0.0] * len(more))
        device.advance(NS_PER_MS)
        return device.read()


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

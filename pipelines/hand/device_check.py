"""What the checks of a user's robot and of a user's joystick share: cycles, and what they measure.

The cores of a session are sure of their inputs; a user's driver is not known. So it is driven by
hand here, with small forces, and whatever it raises is a finding.

One axis behind x and y is checked as a robot or a joystick of its own. Its place is the x of the
view, at its lever, and its y is 0. A force along either is one along it. Meanwhile x, y and the
other axes get no force, or stay.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from itertools import groupby
from math import hypot, isfinite
from resource import RUSAGE_THREAD, getrusage
from typing import Any, Generic, TypeVar

import numpy as np

from kontur_av.clock import NS_PER_MS, NS_PER_S, Clock
from kontur_av.errors import ConfigError
from kontur_av.returned import PartError, fault_of, taken
from telepresence.haptics.axes import AxisCapabilities, AxisReading, MoreAxis, check_axes
from telepresence.haptics.device.device import JoystickCapabilities, JoystickReading
from telepresence.haptics.device.script import CheckResult, Figure
from telepresence.haptics.robot import RobotCapabilities
from telepresence.haptics.robot_device import RobotReading


class _AxisView:
    """device: a `RobotDevice` or a `JoystickDevice` that is a `MoreAxes`, too."""

    def __init__(self, device: Any, index: int) -> None:
        self._device, self._index = device, index
        self.axis = MoreAxis(device.capabilities.more[index])

    def write_force(self, x_n: float, y_n: float) -> None:
        self._device.write_force(0.0, 0.0)
        forces = [0.0] * len(self._device.capabilities.more)
        forces[self._index] = (x_n + y_n) * self.axis.lever_m
        self._device.write_more_forces(forces)

    def advance(self, dt_ns: int) -> None:
        self._device.advance(dt_ns)

    def _more(self) -> AxisReading:
        lever_m = self.axis.lever_m
        position, speed, push, contact = self._device.read_more()[self._index]
        return AxisReading(position * lever_m, speed * lever_m, push / lever_m, contact)


class RobotAxis(_AxisView):
    """One axis of a robot that is configured and has power."""

    def __init__(self, device: Any, index: int) -> None:
        super().__init__(device, index)
        axis, capabilities = self.axis, device.capabilities
        self.capabilities = RobotCapabilities(
            name=axis.capabilities.name,
            takes=capabilities.takes,
            force_limit_n=axis.force_limit_n,
            speed_m_s=axis.most_m_s,
            half_width_m=axis.half_m,
            half_height_m=axis.half_m,
            runs_alone=capabilities.runs_alone,
        )

    def configure(self) -> None:
        """The robot is."""

    power_on = power_off = configure

    def activate(self) -> None:
        self._rest = self._device.read()
        self._positions = [one.position for one in self._device.read_more()]
        self._device.activate()

    def deactivate(self) -> None:
        self._device.deactivate()

    def read(self) -> RobotReading:
        error = self._device.read().error
        position_m, speed_m_s, push_n, contact = self._more()
        return RobotReading(position_m, 0.0, speed_m_s, 0.0, push_n, 0.0, contact, error)

    def write_position(self, x_m: float, y_m: float, vx_m_s: float, vy_m_s: float) -> None:
        lever_m = self.axis.lever_m
        self._device.write_position(self._rest.x_m, self._rest.y_m, 0.0, 0.0)
        positions, speeds = [*self._positions], [0.0] * len(self._positions)
        positions[self._index] = (x_m + y_m) / lever_m
        speeds[self._index] = (vx_m_s + vy_m_s) / lever_m
        self._device.write_more_positions(positions, speeds)


class JoystickAxis(_AxisView):
    """One axis of a joystick that is open."""

    def __init__(self, device: Any, index: int) -> None:
        super().__init__(device, index)
        axis = self.axis
        self.capabilities = JoystickCapabilities(
            name=axis.capabilities.name,
            half_width_m=axis.half_m,
            half_height_m=axis.half_m,
            force_limit_n=axis.force_limit_n if device.capabilities.has_force else 0.0,
        )

    def read(self) -> JoystickReading:
        position_m, speed_m_s, *_ = self._more()
        reading: JoystickReading = self._device.read()
        return reading._replace(x_m=position_m, y_m=0.0, vx_m_s=speed_m_s, vy_m_s=0.0)

    def set_zero(self, x_m: float, y_m: float) -> None:
        """Its middle is where the device reads 0."""

    def write_leds(self, mask: int) -> None: ...

    def show_state(self, state: Any) -> None:
        self._device.show_state(state)

    def close(self) -> None: ...


#: Of a cycle of 1 ms, the rest is the session's.
_MOST_CYCLE_MS = 0.5
#: What is still moves slower than this (m/s), and by less than this (m).
STILL_M_S, STILL_M = 0.005, 0.002
#: A push or a way that a check asks for, as a part of what the device can do.
GENTLE = 0.1
SPELL_NS = 300 * NS_PER_MS
#: A sensor that is slower than this makes the hand feel old forces.
_MOST_SAME_MS = 20
#: Energy that rounding and the sensors' noise may make.
_LEAST_J = -1e-3


R = TypeVar("R", JoystickReading, RobotReading)
#: These are checked of the whole device only.
_WHOLE = {"zero", "dead-man button", "cycle time", "errors", "power off", "unplugged"}
#: What to write, given the share of the time that has passed.
Order = Callable[[float], tuple[float, float]]
#: A check by its name, and why this device cannot be asked; "" if it can.
Check = tuple[str, Callable[[], tuple[Figure, ...]], str]


class DeviceCheck(Generic[R]):
    """Runs the checks of one device; each is a method, and `run` yields their results.

    clock: paces the cycles, and times the calls. axes: those behind x and y that it is to have;
    None: any.
    """

    #: The class of the device's facts, which are asked for when it is switched on.
    _known: type
    #: What shows one of its axes behind x and y as a device.
    _view: type["RobotAxis | JoystickAxis"]

    def __init__(self, device: Any, clock: Clock, axes: Sequence[str] | None = None) -> None:
        self._device, self._clock, self._axes = device, clock, axes
        #: Of the calls that the machine did not interrupt.
        self._calls_ns: list[int] = []
        self._interrupted = 0
        self._readings: list[R] = []
        #: While it was pushed by `moves`; it may not measure the same all the time.
        self._pushed: list[R] = []
        #: The largest step of the place from one reading to the next.
        self._step_m_s = 0.0
        #: Energy that the device got by its port and by its surroundings, now and at its least.
        self._got_j = self._least_j = 0.0
        self._metered = False
        #: It goes on between cycles, and an answer may be of the cycle before.
        self._runs_alone = False
        #: The axis behind x and y that is checked; None: x and y are.
        self._axis: MoreAxis | None = None

    def run(self) -> Iterator[CheckResult]:
        """Switch on, check, switch off; yield a result for each check.

        Raises ConfigError if it cannot be switched on or off.
        """
        try:
            capabilities = self._switched_on()
            yield self._check("capabilities", lambda: self._capabilities(capabilities))
            for name, check, lacks in self._checks():
                yield CheckResult(name, skipped=lacks) if lacks else self._check(name, check)
        finally:
            try:
                self._switch_off()
            except Exception as error:
                words = fault_of("power_off()", error)
                raise ConfigError(f"{words}: it may still have power") from error

    def _switched_on(self) -> Any:
        try:
            capabilities = self._switch_on()
            if self._axes is not None:
                check_axes(capabilities.name, capabilities.more, self._axes)
        except Exception as error:
            raise ConfigError(fault_of("the driver", error)) from error
        return capabilities

    def _capabilities(self, capabilities: Any) -> tuple[Figure, ...]:
        """They can be."""
        taken(self._known, capabilities, "capabilities")
        return ()

    def moves(self) -> tuple[Figure, ...]:
        """It moves along each axis where it is pushed, or led, and not aside."""
        metrics: list[Figure] = []
        for axis in (0, 1) if self._axis is None else (0,):
            began = self._read()
            self._metered = True
            pushed = self._push(axis)
            self._metered = False
            self._pushed += pushed
            ways = [(one.x_m - began.x_m, one.y_m - began.y_m) for one in pushed]
            way_m = max(way[axis] for way in ways)
            if self._axis is not None:
                metrics.append(Figure("way", way_m * 1e3, "mm", least=0.5))
                continue
            aside_m = max(abs(way[1 - axis]) for way in ways)
            name = "xy"[axis]
            metrics += (
                Figure(f"way along {name}", way_m * 1e3, "mm", least=0.5),
                Figure(f"aside of {name}", aside_m * 1e3, "mm", most=max(1.0, way_m * 500)),
            )
        return tuple(metrics)

    def passivity(self) -> tuple[Figure, ...]:
        """While `moves` pushed and braked it, it never had given more energy than it got."""
        # What it keeps as motion counts as got, so it is braked before the sum is judged.
        return (
            Figure("energy got", self._got_j, "J"),
            Figure("least of it", self._least_j, "J", least=_LEAST_J),
        )

    def cycle_time(self) -> tuple[Figure, ...]:
        """Its calls leave room for the session's own work.

        A call in which another program took the processor says nothing of the driver.
        """
        longest = float(np.percentile(self._calls_ns or [0], 99.9)) / NS_PER_MS
        return (
            Figure("its calls, p99.9", longest, "ms", most=_MOST_CYCLE_MS),
            Figure("interrupted by the machine", self._interrupted),
        )

    def errors(self) -> tuple[Figure, ...]:
        """No reading names an error, nor in a rest at the end; else its own words are told."""
        self._cycles(2 * SPELL_NS, None)
        for reading in self._readings:
            if reading.error:
                raise PartError(reading.error)
        return (Figure("with an error", 0, most=0),)

    def _switch_on(self) -> Any:
        """Switch the device on; return its facts."""
        raise NotImplementedError

    def _switch_off(self) -> None:
        raise NotImplementedError

    def _checks(self) -> Sequence[Check]:
        raise NotImplementedError

    def _read(self) -> R:
        raise NotImplementedError

    def _cycle(self, wanted: tuple[float, float] | None, began: R) -> R:
        """One cycle: write what is wanted, if that is something; 1 ms passes; read."""
        raise NotImplementedError

    def _push(self, axis: int) -> list[R]:
        """Push along an axis, or lead; return the readings meanwhile. Then brake."""
        raise NotImplementedError

    def _power_w(self, wanted: tuple[float, float], reading: R) -> float:
        """What the device gets, when it exerts this force (N, N)."""
        return wanted[0] * reading.vx_m_s + wanted[1] * reading.vy_m_s

    @property
    def _same_ms(self) -> list[int]:
        """How long each measurement stayed the same in motion."""
        # Before its first motion and after its last it may measure the same.
        return [len(list(run)) for _, run in groupby(self._pushed)][1:-1]

    def _number_metrics(self, readings: Sequence[Sequence[Any]]) -> tuple[Figure, ...]:
        """Figures of the numbers in all readings: not finite, the same again."""
        wrong = sum(not all(map(isfinite, numbers)) for numbers in readings)
        return (
            Figure("not numbers", wrong, most=0),
            Figure("same in motion", max(self._same_ms, default=0), "ms", most=_MOST_SAME_MS),
            *(() if self._axis is None else (self._beyond_limits(self._axis),)),
        )

    def _beyond_limits(self, axis: MoreAxis) -> Figure:
        """A session takes each of these readings as an error."""
        lever_m = axis.lever_m
        readings = [AxisReading(one.x_m / lever_m, one.vx_m_s / lever_m) for one in self._readings]
        return Figure("beyond its limits", sum(bool(axis.take(one)) for one in readings), most=0)

    def _axes_checks(self) -> Iterator[Check]:
        """Yield the checks of the axes behind x and y; none of one that is described wrongly."""
        for index, capabilities in enumerate(self._device.capabilities.more):
            if isinstance(capabilities, AxisCapabilities):
                view = self._view(self._device, index)
                check = type(self)(view, self._clock)
                check._axis, check._calls_ns = view.axis, self._calls_ns
                in_its_unit = partial(_in_its_unit, lever_m=capabilities.lever_m)
                check._switch_on()
                for name, each, lacks in check._checks():
                    if name not in _WHOLE:
                        yield f"{capabilities.name} {name}", partial(in_its_unit, each), lacks

    def _check(self, name: str, check: Callable[[], tuple[Figure, ...]]) -> CheckResult:
        try:
            return CheckResult(name, check())
        except Exception as error:
            # The driver is the user's: whatever it raises is a finding.
            return CheckResult(name, trouble=fault_of("the driver", error))

    def _still(self, readings: list[R]) -> tuple[Figure, ...]:
        first = readings[0]
        way = max(hypot(reading.x_m - first.x_m, reading.y_m - first.y_m) for reading in readings)
        return (
            Figure("way", way * 1e3, "mm", most=STILL_M * 1e3),
            Figure("speed", max(map(speed, readings)), "m/s", most=STILL_M_S),
        )

    def _slows(self, pushed: list[R], stopped: list[R]) -> Figure:
        """A device that stops within a cycle gains no more speed than in a cycle before."""
        last = speed(pushed[-1])
        in_a_cycle = (last - speed(pushed[0])) / len(pushed)
        gained = max(map(speed, stopped)) - last
        # The answers of one that runs alone are a few cycles late.
        cycles = 4 if self._runs_alone else 1
        most = max(0.0, cycles * in_a_cycle) + STILL_M_S
        return Figure("speed gained", gained, "m/s", most=most)

    def _brake(self, lasts_ns: int, force_limit_n: float) -> list[R]:
        """Exert forces against the motion."""
        most = GENTLE * force_limit_n

        def brake(_share: float) -> tuple[float, float]:
            last = self._readings[-1]
            force_x, force_y = -20.0 * last.vx_m_s, -20.0 * last.vy_m_s
            return max(-most, min(most, force_x)), max(-most, min(most, force_y))

        return self._cycles(lasts_ns, brake)

    def _cycles(self, lasts_ns: int, order: Order | None) -> list[R]:
        """Run cycles of 1 ms; return their readings. Without an order nothing is written."""
        clock = self._clock
        before = began = self._read()
        readings: list[R] = []
        earlier_ns = read_ns = due_ns = clock.now_ns()
        count = lasts_ns // NS_PER_MS
        for cycle in range(count):
            due_ns += NS_PER_MS
            clock.sleep_until_ns(due_ns)
            wanted = None if order is None else order((cycle + 1) / count)
            taken_away = getrusage(RUSAGE_THREAD).ru_nivcsw
            begin_ns = clock.now_ns()
            last = self._cycle(wanted, began)
            end_ns = clock.now_ns()
            if getrusage(RUSAGE_THREAD).ru_nivcsw == taken_away:
                self._calls_ns.append(end_ns - begin_ns)
            else:
                self._interrupted += 1
            readings.append(last)
            self._readings.append(last)
            step_m = max(abs(last.x_m - before.x_m), abs(last.y_m - before.y_m))
            # A real device goes on while this program is late.
            since_ns = earlier_ns if self._runs_alone else read_ns
            lasted_s = max(end_ns - since_ns, NS_PER_MS) / NS_PER_S
            self._step_m_s = max(self._step_m_s, step_m / lasted_s)
            earlier_ns, read_ns = read_ns, end_ns
            before = last
            if wanted is not None and self._metered:
                self._got_j += self._power_w(wanted, last) * NS_PER_MS / NS_PER_S
                self._least_j = min(self._least_j, self._got_j)
        return readings


def speed(reading: JoystickReading | RobotReading) -> float:
    """Return the size of the velocity (m/s)."""
    return hypot(reading.vx_m_s, reading.vy_m_s)


def _in_its_unit(check: Callable[[], tuple[Figure, ...]], *, lever_m: float) -> tuple[Figure, ...]:
    """Figures of a rotation in rad instead of the path at its lever."""
    metrics = check()
    if lever_m == 1.0:
        return metrics
    return tuple(_rotated(each, lever_m) for each in metrics)


def _rotated(figure: Figure, lever_m: float) -> Figure:
    unit = {"mm": "mrad", "m/s": "rad/s"}.get(figure.unit)
    if unit is None:
        return figure
    changes = {
        name: getattr(figure, name) / lever_m
        for name in ("value", "least", "most")
        if getattr(figure, name) is not None
    }
    return replace(figure, unit=unit, **changes)


def along(axis: int, size: float) -> tuple[float, float]:
    return (0.0, size) if axis else (size, 0.0)

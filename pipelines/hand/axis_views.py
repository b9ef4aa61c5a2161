"""One axis behind x and y as a robot or a joystick of its own, for the checks of a user's device.

Its place is the x of the view, at its lever, and its y is 0. A force along either is one along it.
Meanwhile x, y and the other axes get no force, or stay.
"""

from typing import Any

from telepresence.haptics.axes import AxisReading, MoreAxis
from telepresence.haptics.device.device import JoystickFacts, JoystickReading
from telepresence.haptics.robot import RobotFacts
from telepresence.haptics.robot_device import RobotReading


class _AxisView:
    """device: a `RobotDevice` or a `JoystickDevice` that is a `MoreAxes`, too."""

    def __init__(self, device: Any, index: int) -> None:
        self._device, self._index = device, index
        self.axis = MoreAxis(device.facts.more[index])

    def write_force(self, x_n: float, y_n: float) -> None:
        self._device.write_force(0.0, 0.0)
        forces = [0.0] * len(self._device.facts.more)
        forces[self._index] = (x_n + y_n) * self.axis.lever_m
        self._device.write_more_forces(forces)

    def advance(self, dt_ns: int) -> None:
        self._device.advance(dt_ns)

    def _more(self) -> AxisReading:
        lever_m = self.axis.lever_m
        place, speed, push, contact = self._device.read_more()[self._index]
        return AxisReading(place * lever_m, speed * lever_m, push / lever_m, contact)


class RobotAxis(_AxisView):
    """One axis of a robot that is configured and has power."""

    def __init__(self, device: Any, index: int) -> None:
        super().__init__(device, index)
        axis, facts = self.axis, device.facts
        self.facts = RobotFacts(
            name=axis.facts.name,
            takes=facts.takes,
            force_limit_n=axis.force_limit_n,
            speed_m_s=axis.most_m_s,
            half_width_m=axis.half_m,
            half_height_m=axis.half_m,
            runs_alone=facts.runs_alone,
        )

    def configure(self) -> None:
        """The robot is."""

    power_on = power_off = configure

    def activate(self) -> None:
        self._rest = self._device.read()
        self._places = [one.place for one in self._device.read_more()]
        self._device.activate()

    def deactivate(self) -> None:
        self._device.deactivate()

    def read(self) -> RobotReading:
        error = self._device.read().error
        place_m, speed_m_s, push_n, contact = self._more()
        return RobotReading(place_m, 0.0, speed_m_s, 0.0, push_n, 0.0, contact, error)

    def write_position(self, x_m: float, y_m: float, vx_m_s: float, vy_m_s: float) -> None:
        lever_m = self.axis.lever_m
        self._device.write_position(self._rest.x_m, self._rest.y_m, 0.0, 0.0)
        places, speeds = [*self._places], [0.0] * len(self._places)
        places[self._index] = (x_m + y_m) / lever_m
        speeds[self._index] = (vx_m_s + vy_m_s) / lever_m
        self._device.write_more_positions(places, speeds)


class JoystickAxis(_AxisView):
    """One axis of a joystick that is open."""

    def __init__(self, device: Any, index: int) -> None:
        super().__init__(device, index)
        axis = self.axis
        self.facts = JoystickFacts(
            name=axis.facts.name,
            half_width_m=axis.half_m,
            half_height_m=axis.half_m,
            force_limit_n=axis.force_limit_n if device.facts.has_force else 0.0,
        )

    def read(self) -> JoystickReading:
        place_m, speed_m_s, *_ = self._more()
        reading: JoystickReading = self._device.read()
        return reading._replace(x_m=place_m, y_m=0.0, vx_m_s=speed_m_s, vy_m_s=0.0)

    def set_zero(self, x_m: float, y_m: float) -> None:
        """Its middle is where the device reads 0."""

    def write_leds(self, mask: int) -> None: ...

    def show_state(self, state: Any) -> None:
        self._device.show_state(state)

    def close(self) -> None: ...

"""A user's joystick in a session: whatever its driver returns or raises, the session goes on."""

from collections.abc import Callable, Sequence
from typing import cast

from kontur_av.returned import fault_of, taken
from telepresence.haptics.axes import AxisReading, MoreAxes
from telepresence.haptics.device.device import JoystickCapabilities, JoystickDevice, JoystickReading
from telepresence.haptics.device.states import JoystickState

_REST = JoystickReading(0.0, 0.0, 0.0, 0.0)


class UserJoystick:
    """A `JoystickDevice` around a user's. What a call of it raises is the error of each reading
    until the next one without; its dead-man button then is released.

    Raises PartError for facts that cannot be.
    """

    def __init__(self, device: JoystickDevice) -> None:
        self.device = device
        self.capabilities = taken(JoystickCapabilities, device.capabilities, "capabilities")
        self._fault = ""
        self._last = _REST

    def read(self) -> JoystickReading:
        fault, self._fault = self._fault, ""
        try:
            self._last = reading = taken(JoystickReading, self.device.read(), "read()")
        except Exception as error:
            fault = fault_of("read()", error)
            reading = self._last
        return reading if not fault else reading._replace(dead_man=False, error=fault)

    def read_more(self) -> Sequence[AxisReading]:
        readings = cast(MoreAxes, self.device).read_more()
        return taken(tuple[AxisReading, ...], readings, "read_more()")

    def write_more_forces(self, forces: Sequence[float]) -> None:
        axes = cast(MoreAxes, self.device)
        self._call("write_more_forces()", lambda: axes.write_more_forces(forces))

    def write_more_positions(self, positions: Sequence[float], speeds: Sequence[float]) -> None:
        """Only of a robot."""

    def set_zero(self, x_m: float, y_m: float) -> None:
        self._call("set_zero()", lambda: self.device.set_zero(x_m, y_m))

    def write_force(self, x_n: float, y_n: float) -> None:
        self._call("write_force()", lambda: self.device.write_force(x_n, y_n))

    def write_leds(self, mask: int) -> None:
        self._call("write_leds()", lambda: self.device.write_leds(mask))

    def show_state(self, state: JoystickState) -> None:
        self._call("show_state()", lambda: self.device.show_state(state))

    def advance(self, dt_ns: int) -> None:
        self._call("advance()", lambda: self.device.advance(dt_ns))

    def close(self) -> None:
        self.device.close()

    def _call(self, name: str, call: Callable[[], None]) -> None:
        try:
            call()
        except Exception as error:
            self._fault = fault_of(name, error)

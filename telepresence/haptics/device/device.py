"""What a joystick is to the rest: a thing that is read and written once a millisecond."""

from dataclasses import dataclass
from typing import NamedTuple, Protocol

from telepresence.haptics.device.states import State


class Reading(NamedTuple):
    """What the joystick's sensors say.

    x_m, y_m: the handle, as its encoders count: zero is where they were switched on until the
    calibration has found the middle. vx_m_s, vy_m_s: its velocity. buttons: a bit for each that
    is pressed, 0x1 for the first. dead_man: the button under the fingers is pressed.
    temperature_c: of the hotter motor; None without a sensor. present: False once the device is
    gone (unplugged), and then for good.
    """

    x_m: float
    y_m: float
    vx_m_s: float
    vy_m_s: float
    buttons: int = 0
    dead_man: bool = True
    temperature_c: float | None = None
    present: bool = True

    def place(self, axis: int) -> float:
        """x_m for axis 0, y_m for 1."""
        return self.y_m if axis else self.x_m

    def speed(self, axis: int) -> float:
        """vx_m_s for axis 0, vy_m_s for 1."""
        return self.vy_m_s if axis else self.vx_m_s


@dataclass(frozen=True, kw_only=True, slots=True)
class DeviceFacts:
    """What a joystick is said to be, and is held to by its functional checks.

    half_width_m, half_height_m: from the middle of the workspace to its end stops, or to where a
    stick's full travel is mapped to. force_limit_n: what the motors can give, per axis; 0 without
    motors. mass_kg, coulomb_n, viscous_n_s_m: of the handle and what moves with it; they mean
    nothing without motors. buttons, leds: how many, without the dead-man button.
    """

    name: str
    half_width_m: float
    half_height_m: float
    force_limit_n: float = 0.0
    mass_kg: float = 0.0
    coulomb_n: float = 0.0
    viscous_n_s_m: float = 0.0
    buttons: int = 0
    leds: int = 0
    rumble: bool = False

    @property
    def has_force(self) -> bool:
        """Whether its motors can push the handle."""
        return self.force_limit_n > 0.0


class JoystickDevice(Protocol):
    """A joystick, simulated or real. Each cycle: `read`, decide, `write_force`, `advance`.

    None of it blocks. `write_force` beyond the limit is cut to it. `advance` tells how much time
    passes until the next `read`: a simulated device moves on by it, a real one does by itself.
    """

    @property
    def facts(self) -> DeviceFacts: ...

    def read(self) -> Reading:
        """What the sensors say now."""

    def set_zero(self, x_m: float, y_m: float) -> None:
        """What reads (x_m, y_m) now is the middle, and reads 0 from now on."""

    def write_force(self, x_n: float, y_n: float) -> None:
        """Have the motors push with this force (N) until the next call."""

    def write_leds(self, mask: int) -> None:
        """Light these LEDs, 0x1 for the first, and no others."""

    def show_state(self, state: State) -> None:
        """The joystick is in this state now; what the device, or who holds it, makes of that."""

    def advance(self, dt_ns: int) -> None:
        """`dt_ns` pass."""

    def close(self) -> None:
        """No more force and no more light; the device is let go."""

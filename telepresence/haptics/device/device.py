"""The interface of a joystick: it is read and written once a millisecond."""

from dataclasses import dataclass
from typing import NamedTuple, Protocol

from kontur_av.clock import NS_PER_MS
from telepresence.haptics.axes import AxisCapabilities
from telepresence.haptics.device.states import JoystickState

#: A joystick that is told no new force keeps the last one for at most this long.
KEEPS_FORCE_NS = 50 * NS_PER_MS


class JoystickReading(NamedTuple):
    """One reading of the joystick's sensors.

    x_m, y_m: position of the handle. Zero is its position at power-on until the calibration has
    found the middle.
    vx_m_s, vy_m_s: its velocity.
    buttons: one bit for each pressed button, 0x1 for the first.
    dead_man: the dead-man button is pressed; the driver must say so.
    temperature_c: of the hotter motor; None without a sensor.
    present: False once the device is unplugged or closed, and from then on.
    error: why it cannot go on, in one line; "" if it can.
    stop: a button for the emergency stop is pressed. hand_over: one that hands the handle over to a
    policy, or back.
    """

    x_m: float
    y_m: float
    vx_m_s: float
    vy_m_s: float
    buttons: int = 0
    dead_man: bool = False
    temperature_c: float | None = None
    present: bool = True
    error: str = ""
    stop: bool = False
    hand_over: bool = False

    def position(self, axis: int) -> float:
        """Return the position (m) along x for axis 0, along y for axis 1."""
        return self.y_m if axis else self.x_m

    def speed(self, axis: int) -> float:
        """Return the velocity (m/s) along x for axis 0, along y for axis 1."""
        return self.vy_m_s if axis else self.vx_m_s


@dataclass(frozen=True, kw_only=True, slots=True)
class JoystickCapabilities:
    """Nominal properties of a joystick; the functional checks compare the device with them.

    half_width_m, half_height_m: from the middle of the workspace to its end stops, or to the
    position that a stick's full travel is mapped to.
    force_limit_n: what the motors can exert, per axis; 0 without motors.
    mass_kg, coulomb_n, viscous_n_s_m: of the handle and what moves with it; unused without motors.
    buttons, leds: their number, without the dead-man button.
    rumble: whether the device can rumble.
    more: the axes behind x and y; the device then has the methods of `MoreAxes`.
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
    more: tuple[AxisCapabilities, ...] = ()

    @property
    def has_force(self) -> bool:
        """Whether motors can push the handle."""
        return self.force_limit_n > 0.0


class JoystickDevice(Protocol):
    """A joystick, simulated or real. In each cycle: `read`, decide, `write_force`, `advance`.

    No method blocks. `write_force` cuts the force to the device's limit. `advance` says how much
    time passes until the next `read`; a simulated device advances by it, a real one ignores it.
    """

    @property
    def capabilities(self) -> JoystickCapabilities: ...

    def read(self) -> JoystickReading:
        """Return what the sensors measure now."""

    def set_zero(self, x_m: float, y_m: float) -> None:
        """Make the present position (x_m, y_m) the middle, which reads 0 from now on."""

    def write_force(self, x_n: float, y_n: float) -> None:
        """Let the motors exert this force (N, N) until the next call, but at most for 50 ms."""

    def write_leds(self, mask: int) -> None:
        """Light the LEDs in `mask` (0x1 is the first) and no others."""

    def show_state(self, state: JoystickState) -> None:
        """The joystick entered this state; the device or a simulated hand may react to it."""

    def advance(self, dt_ns: int) -> None:
        """`dt_ns` pass until the next `read`."""

    def close(self) -> None:
        """Switch off force and LEDs, and close the device."""

"""A robot and a joystick whose controllers are reached by UDP, in any language. A shell."""

from collections.abc import Sequence
from math import nan

from kontur_av.clock import NS_PER_MS, NS_PER_S
from telepresence.haptics.axes import AxisReading
from telepresence.haptics.device.device import JoystickCapabilities, JoystickReading
from telepresence.haptics.device.states import JoystickState
from telepresence.haptics.device.stick import FollowedAxis
from telepresence.haptics.haptic_metrics import UdpMetrics
from telepresence.haptics.robot import RobotCapabilities
from telepresence.haptics.robot_device import RobotReading
from telepresence.haptics.udp_line import UdpLine
from telepresence.haptics.udp_protocol import (
    MOST_UNANSWERED,
    NO_FORCE,
    UdpRole,
    UdpSession,
    WantedState,
)

#: Half the workspace of an axis that a robot does not have; nothing moves there.
_NO_PLANE_M = 0.01
#: Three numbers of x and y each come first in a datagram.
_BEHIND = 6


class _UdpAxes:
    """The axes behind x and y of a device by UDP; a `MoreAxes`."""

    _session: UdpSession

    def read_more(self) -> list[AxisReading]:
        """Return the newest measurement of each axis."""
        reading = self._session.reading
        values = reading.axes[_BEHIND:] if reading is not None else ()
        parts = (values[0::3], values[1::3], values[2::3])
        return [AxisReading(*each) for each in zip(*parts, strict=True)]

    def write_more_forces(self, forces: Sequence[float]) -> None:
        """Order these forces (N; N m) with the next cycle."""
        more = tuple(value for force in forces for value in (force, 0.0, 0.0))
        self._session.axes = self._session.axes[:_BEHIND] + more

    def write_more_positions(self, positions: Sequence[float], speeds: Sequence[float]) -> None:
        """Order these places and velocities with the next cycle."""
        pairs = zip(positions, speeds, strict=True)
        more = tuple(value for pair in pairs for value in (0.0, *pair))
        self._session.axes = self._session.axes[:_BEHIND] + more

    def _write(self, *plane: float) -> None:
        self._session.axes = plane + self._session.axes[_BEHIND:]


class UdpRobot(_UdpAxes):
    """The robot at `spec`, a `RobotDevice`: HOST:PORT or HOST:PORT:KEYFILE, else ConfigError.

    capabilities: after `configure`.

    When its controller is silent it has an error, and is no more asked to be active until
    `activate` is called anew.
    """

    capabilities: RobotCapabilities

    def __init__(self, spec: str = "") -> None:
        self._line = UdpLine(spec, UdpRole.ROBOT)
        self._session = self._line.session
        #: Why it lost its controller while it was active; until it is deactivated.
        self._lost = ""
        self._off = False

    def configure(self) -> None:
        """Wait for the controller; ConfigError if it does not answer."""
        capabilities = self._line.connect()
        half_width_m, half_height_m = (half_m or _NO_PLANE_M for half_m in capabilities.half_m)
        self.capabilities = RobotCapabilities(
            name=capabilities.name,
            takes="position" if capabilities.takes_positions else "force",
            force="none" if capabilities.buttons == NO_FORCE else "felt",
            force_limit_n=capabilities.force_limit_n,
            speed_m_s=capabilities.speed_m_s,
            half_width_m=half_width_m,
            half_height_m=half_height_m,
            more=capabilities.more,
            runs_alone=True,
        )

    def power_on(self) -> None:
        """Ask for power with the next cycle."""
        self._session.detail = WantedState.POWER

    def activate(self) -> None:
        """Ask for it with the next cycle."""
        self._session.detail = WantedState.ACTIVE

    def deactivate(self) -> None:
        """Ask for brakes with the next cycle."""
        self._session.detail = WantedState.POWER
        self._lost = ""

    def power_off(self) -> None:
        """Ask for no power, and leave."""
        self._session.detail = WantedState.OFF
        self._line.close()
        self._off = True

    def read(self) -> RobotReading:
        """Return the newest measurement. RuntimeError after `power_off`: there is none."""
        if self._off:
            raise RuntimeError("it was switched off")
        self._line.receive()
        session = self._session
        reading = session.reading
        assert reading is not None, "it was configured"
        x_m, vx_m_s, push_x_n, y_m, vy_m_s, push_y_n = reading.axes[:_BEHIND]
        error = self._lost or (self._silence() if session.silent else "")
        if not error and reading.error:
            error = f"error {reading.error}: {reading.text}"
        return RobotReading(x_m, y_m, vx_m_s, vy_m_s, push_x_n, push_y_n, reading.contact, error)

    def write_force(self, x_n: float, y_n: float) -> None:
        """Order this force (N, N) with the next cycle."""
        self._write(x_n, 0.0, 0.0, y_n, 0.0, 0.0)

    def write_position(self, x_m: float, y_m: float, vx_m_s: float, vy_m_s: float) -> None:
        """Order this place (m) and velocity (m/s) with the next cycle."""
        self._write(0.0, x_m, vx_m_s, 0.0, y_m, vy_m_s)

    def advance(self, dt_ns: int) -> None:
        """Send what was ordered."""
        session = self._session
        self._line.send()
        if session.silent and session.detail == WantedState.ACTIVE:
            session.detail = WantedState.POWER
            self._lost = self._silence()

    def metrics(self) -> UdpMetrics:
        """Return what was counted."""
        return self._session.report()

    def _silence(self) -> str:
        problem = self._session.problem
        words = f"its controller did not answer for {MOST_UNANSWERED} ms"
        return f"{words} ({problem})" if problem else words


#: Its place is not a number, which is a recoverable error: it is calibrated before it is trusted.
_SILENT = JoystickReading(nan, nan, 0.0, 0.0, dead_man=False)
_CYCLE_S = NS_PER_MS / NS_PER_S


class UdpJoystick(_UdpAxes):
    """The joystick at `spec`, a `JoystickDevice`: HOST:PORT or HOST:PORT:KEYFILE.

    Waits for its controller. Raises ConfigError for another spec, or if the controller does not
    answer.
    """

    def __init__(self, spec: str = "") -> None:
        self._line = UdpLine(spec, UdpRole.JOYSTICK)
        self._session = self._line.session
        capabilities = self._line.connect()
        half_width_m, half_height_m = (half_m or _NO_PLANE_M for half_m in capabilities.half_m)
        #: What the controller said at first.
        self.capabilities = JoystickCapabilities(
            name=capabilities.name,
            half_width_m=half_width_m,
            half_height_m=half_height_m,
            force_limit_n=capabilities.force_limit_n,
            mass_kg=capabilities.mass_kg,
            coulomb_n=capabilities.coulomb_n,
            viscous_n_s_m=capabilities.viscous_n_s_m,
            buttons=capabilities.buttons,
            leds=capabilities.leds,
            more=capabilities.more,
        )
        self._more = [FollowedAxis(_CYCLE_S) for _ in capabilities.more]
        self._zero_x = self._zero_y = 0.0
        # With late readings the place jumps; a motion without jumps is followed at once.
        self._x, self._y = FollowedAxis(_CYCLE_S), FollowedAxis(_CYCLE_S)

    def read(self) -> JoystickReading:
        """Return the newest reading."""
        self._line.receive()
        session = self._session
        reading = session.reading
        if reading is None or session.silent:
            return _SILENT
        x, y = self._x, self._y
        return JoystickReading(
            x.position - self._zero_x,
            y.position - self._zero_y,
            x.speed,
            y.speed,
            reading.buttons,
            reading.dead_man,
            reading.temperature_c,
        )

    def set_zero(self, x_m: float, y_m: float) -> None:
        """Make the present position (x_m, y_m) the middle."""
        self._zero_x += x_m
        self._zero_y += y_m

    def write_force(self, x_n: float, y_n: float) -> None:
        """Order this force (N, N), cut to the device's limit, with the next cycle."""
        limit = self.capabilities.force_limit_n
        x_n, y_n = max(-limit, min(limit, x_n)), max(-limit, min(limit, y_n))
        self._write(x_n, 0.0, 0.0, y_n, 0.0, 0.0)

    def write_leds(self, mask: int) -> None:
        """Light these LEDs with the next cycle."""
        self._session.leds = mask

    def show_state(self, state: JoystickState) -> None:
        """Tell the controller the state with the next cycle."""
        self._session.detail = state

    def advance(self, dt_ns: int) -> None:
        """Send what was ordered, and follow the newest reading."""
        self._line.send()
        if (reading := self._session.reading) is not None:
            self._x.advance(reading.axes[0], dt_ns)
            self._y.advance(reading.axes[3], dt_ns)
            places = reading.axes[_BEHIND::3]
            for axis, capabilities, place in zip(
                self._more, self.capabilities.more, places, strict=True
            ):
                axis.advance(place * capabilities.lever_m, dt_ns)

    def read_more(self) -> list[AxisReading]:
        """Return the followed places."""
        return [
            AxisReading(axis.position / one.lever_m, axis.speed / one.lever_m)
            for axis, one in zip(self._more, self.capabilities.more, strict=True)
        ]

    def metrics(self) -> UdpMetrics:
        """Return what was counted."""
        return self._session.report()

    def close(self) -> None:
        """Order no force and no LEDs, and leave."""
        session = self._session
        session.detail, session.leds = JoystickState.INIT, 0
        self.write_force(0.0, 0.0)
        self.write_more_forces([0.0] * len(self._more))
        self._line.close()

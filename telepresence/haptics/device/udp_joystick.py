"""A joystick whose controller is reached by UDP, in any language: a `JoystickDevice`. A shell."""

from math import nan

from kontur_av.clock import NS_PER_MS, NS_PER_S
from telepresence.haptics.device.device import JoystickFacts, JoystickReading
from telepresence.haptics.device.states import JoystickState
from telepresence.haptics.device.stick import FollowedAxis
from telepresence.haptics.figures import UdpFigures
from telepresence.haptics.udp_line import UdpLine
from telepresence.haptics.udp_protocol import UdpRole

#: Its place is not a number, which is a recoverable error: it is calibrated before it is trusted.
_SILENT = JoystickReading(nan, nan, 0.0, 0.0, dead_man=False)
_CYCLE_S = NS_PER_MS / NS_PER_S


class UdpJoystick:
    """The joystick at `spec`: HOST:PORT or HOST:PORT:KEYFILE. Waits for its controller.

    Raises ConfigError for another spec, or if the controller does not answer.
    """

    def __init__(self, spec: str = "") -> None:
        self._line = UdpLine(spec, UdpRole.JOYSTICK)
        self._session = self._line.session
        facts = self._line.connect()
        half_width_m, half_height_m = facts.half_m
        #: What the controller said at first.
        self.facts = JoystickFacts(
            name=facts.name,
            half_width_m=half_width_m,
            half_height_m=half_height_m,
            force_limit_n=facts.force_limit_n,
            mass_kg=facts.mass_kg,
            coulomb_n=facts.coulomb_n,
            viscous_n_s_m=facts.viscous_n_s_m,
            buttons=facts.buttons,
            leds=facts.leds,
        )
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
            x.place - self._zero_x,
            y.place - self._zero_y,
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
        limit = self.facts.force_limit_n
        x_n, y_n = max(-limit, min(limit, x_n)), max(-limit, min(limit, y_n))
        self._session.axes = (x_n, 0.0, 0.0, y_n, 0.0, 0.0)

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

    def figures(self) -> UdpFigures:
        """Return what was counted."""
        return self._session.report()

    def close(self) -> None:
        """Order no force and no LEDs, and leave."""
        session = self._session
        session.detail, session.leds = JoystickState.INIT, 0
        self.write_force(0.0, 0.0)
        self._line.close()

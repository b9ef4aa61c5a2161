"""A robot whose controller is reached by UDP, in any language: a `RobotDevice`. A shell."""

from telepresence.haptics.figures import UdpFigures
from telepresence.haptics.robot import RobotFacts
from telepresence.haptics.robot_device import RobotReading
from telepresence.haptics.udp_line import UdpLine
from telepresence.haptics.udp_protocol import UdpRole, WantedState
from telepresence.haptics.udp_session import MOST_UNANSWERED


class UdpRobot:
    """The robot at `spec`: HOST:PORT or HOST:PORT:KEYFILE; ConfigError for others.

    facts: after `configure`.

    When its controller is silent it has an error, and is no more asked to be active until
    `activate` is called anew.
    """

    facts: RobotFacts

    def __init__(self, spec: str = "") -> None:
        self._line = UdpLine(spec, UdpRole.ROBOT)
        self._session = self._line.session
        #: Why it lost its controller while it was active; until it is deactivated.
        self._lost = ""
        self._off = False

    def configure(self) -> None:
        """Wait for the controller; ConfigError if it does not answer."""
        facts = self._line.connect()
        half_width_m, half_height_m = facts.half_m
        self.facts = RobotFacts(
            name=facts.name,
            takes="position" if facts.takes_places else "force",
            force_limit_n=facts.force_limit_n,
            speed_m_s=facts.speed_m_s,
            half_width_m=half_width_m,
            half_height_m=half_height_m,
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
        x_m, vx_m_s, push_x_n, y_m, vy_m_s, push_y_n = reading.axes
        error = self._lost or (self._silence() if session.silent else "")
        if not error and reading.error:
            error = f"error {reading.error}: {reading.text}"
        return RobotReading(x_m, y_m, vx_m_s, vy_m_s, push_x_n, push_y_n, reading.contact, error)

    def write_force(self, x_n: float, y_n: float) -> None:
        """Order this force (N, N) with the next cycle."""
        self._session.axes = (x_n, 0.0, 0.0, y_n, 0.0, 0.0)

    def write_position(self, x_m: float, y_m: float, vx_m_s: float, vy_m_s: float) -> None:
        """Order this place (m) and velocity (m/s) with the next cycle."""
        self._session.axes = (0.0, x_m, vx_m_s, 0.0, y_m, vy_m_s)

    def advance(self, dt_ns: int) -> None:
        """Send what was ordered."""
        session = self._session
        self._line.send()
        if session.silent and session.detail == WantedState.ACTIVE:
            session.detail = WantedState.POWER
            self._lost = self._silence()

    def figures(self) -> UdpFigures:
        """Return what was counted."""
        return self._session.report()

    def _silence(self) -> str:
        problem = self._session.problem
        words = f"its controller did not answer for {MOST_UNANSWERED} ms"
        return f"{words} ({problem})" if problem else words

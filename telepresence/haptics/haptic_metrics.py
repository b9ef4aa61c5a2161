"""What the two ends of haptics count: one typed record for each part. A core."""

from dataclasses import dataclass

from kontur_av.metrics import Least, Most, Newest


@dataclass(frozen=True, slots=True, kw_only=True)
class SamplesSent:
    """Samples of one end that it sent (`HapticLink`)."""

    #: Samples sent, without greetings.
    sent: int = 0
    #: Samples left out; only with a deadband.
    left_out: int | None = None


@dataclass(slots=True, kw_only=True)
class SamplesReceived:
    """Samples that came to one end (`HapticLink`), counted in place."""

    #: Samples that were the newest.
    received: int = 0
    #: Gaps in the sequence numbers; a late arrival fills one.
    lost: int = 0
    #: Samples that came after a newer one, or too far ahead of it.
    late: int = 0
    #: Samples that came twice.
    repeated: int = 0
    #: Samples of another session: an end's earlier start, or replayed.
    strays: int = 0
    #: Greetings received, with which sessions begin.
    greetings: int = 0
    #: Echoes received, by which the robot knows how old its commands are.
    echoes: int = 0
    #: Datagrams that are neither sample, greeting nor echo.
    garbage: int = 0
    #: Sessions begun, one every 30 s.
    sessions: int = 0
    #: Sessions begun with a new start of the peer.
    restarts: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class HandInputMetrics:
    """The inputs of the page or node that holds the handle (`PageDevice`)."""

    #: Too old, repeated, not finite or out of range.
    inputs_ignored: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class PortMetrics:
    """Energies of the port at one end, and its passivity controller (`JoystickSide.report`)."""

    #: Energy from this end into the port.
    energy_in_uj: int = 0
    #: Energy out of the port at this end.
    energy_out_uj: int = 0
    #: Energy that the other end granted.
    granted_uj: int = 0
    #: Energy that this end may still give out.
    credit_uj: Newest[int] = 0
    #: Least value of the passivity observer; below 0 the port gave more than it got.
    least_uj: Least[int] = 0
    #: Cycles in which the controller changed force or motion.
    passivity_acted: int = 0
    #: Impossible totals of the peer's energy.
    totals_refused: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class OperationMetrics:
    """A joystick in operation (`Operation`)."""

    #: The device's name.
    device: str
    #: Its state in words (docs/operator.md).
    state: str
    #: The reason for the state, or for supervision's last intervention.
    reason: str
    #: Null if the device measures none.
    temperature_c: float | None
    #: The highest temperature so far.
    hottest_c: Most[float] | None
    temperature_warnings: int
    #: Share of the force that the temperature allows, 0 to 1.
    force_share: float
    #: The largest force at present.
    force_limit_n: float
    #: Transitions of its state machine.
    transitions: int
    #: Events that it refused.
    refused: int
    #: Releases of the dead-man button.
    dead_man_released: int
    #: Centre x and y, half width and half height; null before calibration.
    calibration_mm: list[float] | None


@dataclass(frozen=True, slots=True, kw_only=True)
class LoggedTransition:
    """One transition of the joystick's state machine."""

    #: Time since the joystick began.
    s: float
    #: What caused it.
    event: str
    #: The state after it, in words.
    state: str
    reason: str


@dataclass(frozen=True, slots=True, kw_only=True)
class JoystickMetrics(OperationMetrics):
    """A joystick in a session (`OperatedHandle`)."""

    #: The last 20 transitions.
    log: list[LoggedTransition]


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotMetrics:
    """A robot in a session (`RobotControl`)."""

    #: Its fault now, in its driver's own words; empty: none. It is off meanwhile.
    fault: Newest[str] = ""
    #: What its driver says is wrong now; empty: nothing.
    error: Newest[str] = ""
    #: Faults so far.
    faults: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class UdpMetrics:
    """A robot's or joystick's controller that is reached by UDP (`UdpSession`)."""

    #: Handshakes that succeeded.
    udp_sessions: int = 0
    #: Sessions that ended by its silence.
    udp_losses: int = 0
    udp_commands: int = 0
    udp_readings: int = 0
    #: The most commands in a row without an answer.
    udp_unanswered: Most[int] = 0
    #: Readings that came after a newer one, or twice.
    udp_late: int = 0
    #: Of another key or session.
    udp_foreign: int = 0
    udp_malformed: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class WallMetrics:
    """A joystick that renders the wall of the robot's side (`--hand mediated`)."""

    #: Messages with a wall, or with none, that were taken.
    walls: int = 0
    #: Messages that were not newer than one before.
    walls_stale: int = 0
    #: Datagrams that are not such a message.
    walls_garbage: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class PressMetrics:
    """How hard the robot presses against what the hand gives, along x and y (`JoystickSide`)."""

    #: How hard the robot presses now, by its newest sample or by the rendered wall.
    presses_n: Newest[float] = 0.0
    #: What the hand gives against it now: the force of the handle's motors.
    gives_n: Newest[float] = 0.0
    #: The most by which the robot has pressed harder than the hand gave.
    beyond_n: Most[float] = 0.0

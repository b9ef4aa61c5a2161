"""What page, joystick, robot and the arbiter of control publish; the arbiter.

| topic | writer | content |
|---|---|---|
| `hand/input` | page | `PageInput`: the newest hand of the page that holds the handle |
| `hand/request` | page | `HandRequest`: a person's command |
| `joystick/command` | console | `HandRequest`: a telecommand of the ground or of this end |
| `joystick/state` | joystick | `JoystickStatus`: its state, and what became of the newest command |
| `arm/order` | desk | who is to drive |
| `arm/state` | robot | `ArmState`: who drives |
"""

import struct
from typing import NamedTuple

import msgspec

from telepresence.haptics.authority import Authority, AuthorityMetrics
from telepresence.haptics.axes import AXIS_NAMES
from telepresence.haptics.device.page import PageInput
from telepresence.haptics.device.states import REQUESTS, ExperimentName, JoystickEvent
from telepresence.malformed import MALFORMED

_INPUT = struct.Struct("<?ddIIqq")
_SHARE_OCTETS = 8
#: With all axes.
INPUT_OCTETS = _INPUT.size + _SHARE_OCTETS * len(AXIS_NAMES)
_NUMBER = struct.Struct("<q")
_EVENTS = {event.value.encode("ascii"): event for event in REQUESTS}
REQUEST_OCTETS = _NUMBER.size + max(len(name) for name in _EVENTS)
#: Texts are cut to this length, so that the state is never too long for its topic.
MOST_CHARACTERS = 400
STATUS_OCTETS = 8192


def pack_input(hand: PageInput) -> bytes:
    """Return at most `INPUT_OCTETS` octets."""
    return _INPUT.pack(*hand[:-1]) + struct.pack(f"<{len(hand.more)}d", *hand.more)


def unpack_input(data: bytes) -> PageInput | None:
    """Return what `pack_input` packed, or None for octets of another size."""
    axes, rest = divmod(len(data) - _INPUT.size, _SHARE_OCTETS)
    if rest or not 0 <= axes <= len(AXIS_NAMES):
        return None
    more = struct.unpack_from(f"<{axes}d", data, _INPUT.size)
    return PageInput._make((*_INPUT.unpack_from(data), more))


class HandRequest(NamedTuple):
    """A person's command. number: the next one of the page's process."""

    number: int
    event: JoystickEvent


def pack_request(request: HandRequest) -> bytes:
    """Return at most `REQUEST_OCTETS` octets."""
    return _NUMBER.pack(request.number) + request.event.value.encode("ascii")


def unpack_request(data: bytes) -> HandRequest | None:
    """Return what `pack_request` packed, or None for anything else."""
    event = _EVENTS.get(data[_NUMBER.size :])
    return None if event is None else HandRequest(_NUMBER.unpack_from(data)[0], event)


class RobotOrders(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What outlives the controller.

    powered, mode: as `telepresence.tasks.robot_control.RobotControl` has them. board: the joystick
    asked for the partner's robot.
    """

    powered: bool
    mode: str
    board: bool = False


class JoystickOrders(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What outlives the process. paused: as the operation has it."""

    paused: str
    experiment: ExperimentName = ExperimentName.GERMAN


class AxisStatus(msgspec.Struct, frozen=True, kw_only=True, array_like=True):
    """An axis of the joystick behind x and y: m and N, of rotations rad and N m.

    force: that its motor exerts.
    """

    name: str
    position: float
    half_range: float
    force: float
    force_limit: float


class JoystickStatus(msgspec.Struct, frozen=True, kw_only=True, array_like=True):
    """The joystick as its operator must know it.

    state: number of a `JoystickState`. reason: why it is in it, or what a person should do,
    in one line; "" for neither.
    dead_man: the dead-man button is pressed. force_limit_n: the force (N) that there may be now.
    device: its name. half_width_m, half_height_m: half of its workspace.
    answered: number of the newest `HandRequest` that was handled; None for none.
    refusal: why that was refused, in one line; "" if it was carried out.
    commanded, command_refusal: the same for telecommands.
    temperature_c: of the hotter motor (°C); None without a thermometer.
    x_m, y_m: place of the handle from the centre. pressed: how often a button went down.
    robot_waits, robot_stopped: the robot's newest sample says that it waits for a new press, and
    that an emergency stop holds it. command_age_ms: how old the commands are that it gets, at most;
    None if unknown.
    axes: those behind x and y.
    test, test_part, test_reason, test_number: the newest functional test, as
    `telepresence.haptics.device.functional_test.TestReport` has it. test_metrics: what it measured,
    by the figures' names; None where nothing could be.
    experiment: of the present or the next application. partner: whether a partner's robot is
    there; None: the session has none.
    """

    state: int
    reason: str
    dead_man: bool
    force_limit_n: float
    device: str
    half_width_m: float
    half_height_m: float
    answered: int | None = None
    refusal: str = ""
    commanded: int | None = None
    command_refusal: str = ""
    temperature_c: float | None = None
    x_m: float = 0.0
    y_m: float = 0.0
    pressed: int = 0
    robot_waits: bool = False
    robot_stopped: bool = False
    command_age_ms: int | None = None
    axes: tuple[AxisStatus, ...] = ()
    test: str = "none"
    test_part: str = "none"
    test_reason: str = ""
    test_number: int = 0
    test_metrics: dict[str, float | None] = {}
    experiment: ExperimentName = ExperimentName.GERMAN
    partner: bool | None = None


def pack_status(status: JoystickStatus) -> bytes:
    """Return at most `STATUS_OCTETS` octets."""
    return _ENCODER.encode(status)


def unpack_status(data: bytes) -> JoystickStatus | None:
    """Return what `pack_status` packed, or None for anything else."""
    try:
        return _DECODER.decode(data)
    except MALFORMED:
        return None


_ENCODER = msgspec.msgpack.Encoder()
_DECODER = msgspec.msgpack.Decoder(JoystickStatus)


#: The name of the arbiter's socket.
ARM_SOCKET = "arm"
ARM_ORDER_OCTETS = max(len(authority.value) for authority in Authority)
ARM_STATE_OCTETS = 256
AUTHORITIES = tuple(authority.value for authority in Authority)


class ArmState(msgspec.Struct, frozen=True, kw_only=True, array_like=True):
    """Who drives; "": nobody. waiting: for a released dead-man button."""

    authority: str = ""
    wanted: str = ""
    waiting: bool = False
    refused_operator: int = 0
    refused_partner: int = 0

    @classmethod
    def of(cls, metrics: AuthorityMetrics, *, waiting: bool) -> "ArmState":
        """Return the state in the figures of a port; waiting: for a new press."""
        return cls(
            authority="" if metrics.authority is None else metrics.authority.value,
            wanted=metrics.wanted.value,
            waiting=waiting and metrics.authority is not None,
            refused_operator=metrics.refused[Authority.OPERATOR.value],
            refused_partner=metrics.refused[Authority.PARTNER.value],
        )

    def pack(self) -> bytes:
        """Return at most `ARM_STATE_OCTETS` octets."""
        return msgspec.msgpack.encode(self)

    @classmethod
    def unpack(cls, octets: bytes) -> "ArmState":
        """Return what `pack` packed. Only the session's own robot writes the topic."""
        return msgspec.msgpack.decode(octets, type=cls)


class AuthorityRequest(msgspec.Struct, frozen=True):
    """What a terminal asks. authority: who is to drive; None only asks who does."""

    authority: Authority | None = None


class AuthorityAnswer(msgspec.Struct, frozen=True, kw_only=True, tag=True):
    """Who drives; "": nobody. waiting: for a released dead-man button."""

    authority: str
    wanted: str
    waiting: bool


class ControlArbiter:
    """Takes requests. After each input publish `order`.

    order: who is to drive. It outlives the process: give the last one.
    """

    def __init__(self, order: Authority = Authority.OPERATOR) -> None:
        self.order = order
        self._state = ArmState(wanted=order.value)

    def handle_state(self, state: ArmState) -> None:
        """The robot has told who drives."""
        self._state = state

    def handle_request(self, request: AuthorityRequest, _now_ns: int) -> AuthorityAnswer:
        self.order = request.authority or self.order
        state = self._state
        return AuthorityAnswer(
            authority=state.authority, wanted=self.order.value, waiting=state.waiting
        )

"""What page, joystick, robot and the arbiter of control publish; the arbiter."""

from typing import NamedTuple

import msgspec

from pipelines.session.topic import Topic
from telepresence.haptics.authority import Authority, AuthorityMetrics
from telepresence.haptics.device.page import PageInput
from telepresence.haptics.device.policy import Place, PolicyMessage
from telepresence.haptics.device.states import ExperimentName, JoystickEvent
from telepresence.haptics.sample import Drive

#: Texts are cut to this length, so that a state stays short.
MOST_CHARACTERS = 400

HAND_INPUT_TOPIC = Topic[PageInput](
    "hand/input", PageInput, "where a page's hand wants the handle, dead-man button"
)
ROS2_HAND_TOPIC = Topic[PageInput]("hand/ros2", PageInput, "the same of a ROS 2 node's hand")
POLICY_TOPIC = Topic[PolicyMessage](
    "hand/policy", PolicyMessage, "where a policy's program wants the robot"
)


class DriverState(msgspec.Struct, frozen=True, kw_only=True, array_like=True):
    """Who has the handle at the operator's seat.

    who: a person or the policy; "" for nobody. policy: one that is there and may drive.
    drives: it is obeyed: it presses the dead-man button. wanted: where it wants the robot, by
    `axes`: m, of rotations rad; empty: nowhere.
    """

    who: str = ""
    policy: str = ""
    drives: bool = False
    axes: tuple[str, ...] = ()
    wanted: Place = ()


DRIVER_TOPIC = Topic[DriverState]("hand/driver", DriverState, "who has the handle")


class HandRequest(NamedTuple):
    """A person's command. number: the next one of the page's process."""

    number: int
    event: JoystickEvent


HAND_REQUEST_TOPIC = Topic[HandRequest](
    "hand/request", HandRequest, "a person's command to the joystick"
)
JOYSTICK_COMMAND_TOPIC = Topic[HandRequest](
    "joystick/command", HandRequest, "a telecommand to the joystick"
)


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

    force: that its motor exerts. unit: of the position, "m" or "rad".
    """

    name: str
    position: float
    half_range: float
    force: float
    force_limit: float
    unit: str = "m"


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
    that an emergency stop holds it. drive: what drives it, as of `OperatedHandle`. blind: the
    operator's picture is too old; frozen: only a part of it. held: the dead-man button is pressed,
    for a test, too. request: which leads on; "": it goes on by itself. command_age_ms: how old the
    commands are that it gets, at most; None if unknown.
    axes: those behind x and y.
    test, test_part, test_reason, test_number: the newest functional test, as
    `telepresence.haptics.device.functional_test.TestReport` has it. test_metrics: what it measured,
    by the figures' names; None where nothing could be.
    experiment: of the present or the next application. partner: whether a partner's robot is
    there; None: the session has none.
    handed: number of the newest command that hands over, and to whom, "policy" or "person".
    person: a person presses the dead-man button, where a policy could, too.
    presses_n: how hard the robot presses (N), as far as is known here.
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
    drive: Drive = ""
    blind: bool = False
    frozen: bool = False
    held: bool = False
    request: str = ""
    handed: tuple[int, str] = (0, "")
    person: bool = False
    presses_n: float = 0.0


JOYSTICK_STATE_TOPIC = Topic[JoystickStatus](
    "joystick/state", JoystickStatus, "state of the joystick, answer to a command"
)

#: The name of the arbiter's socket.
ARM_SOCKET = "arm"
#: Who is to drive.
ARM_ORDER_TOPIC = Topic[Authority]("arm/order", Authority, "who is to drive the robot")
AUTHORITIES = tuple(authority.value for authority in Authority)


class ArmState(msgspec.Struct, frozen=True, kw_only=True, array_like=True):
    """Who drives; "": nobody. waiting: for a new press of the dead-man button."""

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


ARM_STATE_TOPIC = Topic[ArmState]("arm/state", ArmState, "who drives, and refused datagrams")


class AuthorityRequest(msgspec.Struct, frozen=True):
    """What a terminal asks. authority: who is to drive; None only asks who does."""

    authority: Authority | None = None


class AuthorityAnswer(msgspec.Struct, frozen=True, kw_only=True, tag=True):
    """Who drives; "": nobody. waiting: for a new press of the dead-man button."""

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

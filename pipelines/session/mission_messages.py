"""What the processes of a mission tell each other through topics, which are declared at the end."""

from typing import Annotated, Literal

import msgspec

from pipelines.session.session_metrics import gathered
from pipelines.session.topic import Topic
from telepresence.tasks.definitions import ControlMode, Pattern
from telepresence.tasks.panel_picture import PanelPicture
from telepresence.world.state import WorldState

OrderKind = Literal["power", "mode", "move", "reset"]
_Octet = Annotated[int, msgspec.Meta(ge=0, le=255)]


class RobotOrder(msgspec.Struct, frozen=True, array_like=True):
    """An order. number: grows, also over starts of the sender. on: of "power".

    mode: of "mode". x_m, y_m: of "move".
    """

    number: int
    kind: OrderKind
    on: bool = False
    mode: ControlMode = ControlMode.POSITION
    x_m: float = 0.0
    y_m: float = 0.0


class RobotCommand(msgspec.Struct, frozen=True, array_like=True):
    """A function of PUS that a telecommand asks for. number: as in `RobotOrder`.

    mode: of "set_mode".
    """

    number: int
    function: str
    mode: ControlMode = ControlMode.POSITION


class RobotStatus(msgspec.Struct, frozen=True, kw_only=True, array_like=True):
    """The robot controller. boot_id: of its process. handled: number of the newest order.

    x_m, y_m: of the tip. push_n: the board's force. goal_m: where it rests after a move.
    fault: one line, "" for none. error: its kind, a `telepresence.tasks.robot_control.Fault`.
    halted: the newest sample of the joystick says that it is.
    commanded: number of the newest `RobotCommand`; None for none. command_refusal: why that was
    refused, "" if it was carried out. step_hz: cycles of the controller, in the last second.
    hold: why it follows no hand, in words, "" if it does. waiting: for a new press. stopped: an
    emergency stop holds. barred: why a new press would not count now; "": it would. blind: the
    operator's picture is frozen in part. stopped_by: who orders the stop; a joystick's order stays
    after a release here. offset_mm: the robot's place less the hand's. holds: its hand holds a
    ball. joints: of each the angle in rad and the torque in N m, as far as the robot says them.
    axes: of each behind x and y its name, place and force of its surroundings: m and N, or rad and
    N m. partner: of the partner's robot, "none", "absent", "ready" or "driven". partner_seen:
    while it is driven: the place (x, y) that the joystick wants (m), its force (N), whether it
    touches something, and the age (ms) of its newest sample. fields: of a cycle, by their
    parameters.
    """

    boot_id: int
    powered: bool
    mode: ControlMode
    x_m: float
    y_m: float
    push_n: float
    goal_m: tuple[float, float] | None = None
    fault: str = ""
    faults: int = 0
    refused: int = 0
    handled: int = 0
    halted: bool = False
    error: str = "none"
    commanded: int | None = None
    command_refusal: str = ""
    step_hz: float = 0.0
    hold: str = ""
    waiting: bool = False
    stopped: bool = False
    offset_mm: tuple[float, float] = (0.0, 0.0)
    holds: bool = False
    joints: tuple[tuple[float, float], ...] = ()
    partner: str = "none"
    stopped_by: str = ""
    axes: tuple[tuple[str, float, float], ...] = ()
    barred: str = ""
    blind: bool = False
    partner_seen: tuple[float, float, float, bool, int] | None = None
    fields: dict[str, float] = {}


class CameraRequest(msgspec.Struct, frozen=True, array_like=True):
    """The camera that a task selects. number: grows with each."""

    number: int
    camera: str


class PanelShown(msgspec.Struct, frozen=True, kw_only=True, array_like=True):
    """The panel, as `telepresence.tasks.panel.PanelView` has it; handle_m: where the handle is."""

    mode: str
    task: str
    run: int
    text: str
    words: str
    start_m: tuple[float, float]
    held_s: float
    handle_m: tuple[float, float] = (0.0, 0.0)
    dead_man: bool = False
    hold_s: float = 0.0
    left_s: float | None = None
    goal: str = ""
    target_m: tuple[float, float] | None = None
    step: int = 0
    steps: int = 0
    percent: int = 0
    force_n: float = 0.0


class TaskListed(msgspec.Struct, frozen=True, array_like=True):
    """A task. lacks: why it cannot be selected here; "" if it can."""

    name: str
    text: str
    lacks: str = ""


class StepShown(msgspec.Struct, frozen=True, array_like=True):
    """A step of a run, at an instant of the session's clock."""

    at_ns: int
    run: int
    task: str
    step: str


class RunShown(msgspec.Struct, frozen=True, array_like=True):
    """A run that is over. seconds: from its start; None if it never started. score: in words."""

    task: str
    run: int
    result: str
    reason: str
    seconds: float | None
    score: str = ""


class ExperimentShown(msgspec.Struct, frozen=True, kw_only=True, array_like=True):
    """The experiment: its phase, the present task ("" without), Elemop, and what the panel shows.

    tasks: in the catalogue's order, by whose index telecommands name them. steps: the newest ones.
    runs: the newest ones. planned: a plan selects the tasks.
    """

    phase: str
    task: str
    run: int
    elemop: str
    panel: str
    tasks: tuple[TaskListed, ...]
    steps: tuple[StepShown, ...] = ()
    runs: tuple[RunShown, ...] = ()
    planned: bool = False


class LedsShown(msgspec.Struct, frozen=True, kw_only=True, array_like=True):
    """The LED panel, as `telepresence.tasks.panel_picture.PanelPicture` has it."""

    pattern: Pattern
    leds: _Octet
    spot_m: tuple[float, float]
    colour: tuple[_Octet, _Octet, _Octet]

    @classmethod
    def of(cls, picture: PanelPicture) -> "LedsShown":
        return gathered(cls, picture)

    @property
    def picture(self) -> PanelPicture:
        return PanelPicture(self.pattern, self.leds, self.spot_m, self.colour)


ROBOT_COMMAND_TOPIC = Topic[RobotCommand](
    "robot/command", RobotCommand, "a telecommand to the robot controller"
)
ROBOT_ORDER_TOPIC = Topic[RobotOrder](
    "robot/order", RobotOrder, "the kernel's order to the robot controller"
)
ROBOT_STATUS_TOPIC = Topic[RobotStatus](
    "robot/status", RobotStatus, "power, mode and fault of the robot, answer to a command"
)
MISSION_CAMERA_TOPIC = Topic[CameraRequest](
    "mission/camera", CameraRequest, "the camera that a task selects"
)
MISSION_GROUND_TOPIC = Topic[ExperimentShown](
    "mission/ground", ExperimentShown, "phase, task, steps and runs of the experiment"
)
MISSION_PANEL_TOPIC = Topic[PanelShown](
    "mission/panel", PanelShown, "what the mission control panel shows"
)
MISSION_LEDS_TOPIC = Topic[LedsShown]("mission/leds", LedsShown, "what the LED panel shows")
#: The state of the robot, from which the built-in scenes draw, and of the arm of a partner.
ROBOT_TOPIC = Topic[WorldState](
    "robot/state", WorldState, "instant, position of the tip, force and contact"
)
SECOND_ROBOT_TOPIC = Topic[WorldState]("robot/second", WorldState, "state of the second arm")

"""What an end of a session knows of hand and robot: the question that `situation` answers. A core.

The server of a seat and the TM/TC end of a segment both ask it, so that pages, telemetry and
terminal say the same.
"""

from typing import NamedTuple

from msgspec.structs import replace

from kontur_av.clock import NS_PER_MS, NS_PER_S
from pipelines.hand.hand_topics import JoystickStatus
from pipelines.session.access import Role
from pipelines.session.mission_messages import ExperimentShown, PanelShown, RobotStatus
from pipelines.session.setup.segments import Segment
from pipelines.session.situation import SIMULATED, Known
from pipelines.session.topology.table import Topology
from telepresence.haptics.device.functional_test import Outcome
from telepresence.haptics.device.states import ExperimentName, JoystickState
from telepresence.haptics.envelope import Hold
from telepresence.haptics.sample import Drive
from telepresence.haptics.specs import is_simulated
from telepresence.tasks.definitions import ControlMode

#: What has been silent for longer is not heard.
_HEARD_NS = 2 * NS_PER_S


class EndTraits(NamedTuple):
    """What does not change. orders, device: as `Known` has them.

    answers_ns: a press is answered within this time.
    """

    segment: Segment
    orders: bool
    device: str
    answers_ns: int

    @classmethod
    def of(cls, topology: Topology, segment: Segment) -> "EndTraits":
        """In space people start and stop only a session that runs here whole."""
        setup, joystick = topology.setup, topology.options.joystick
        return cls(
            segment=segment,
            orders=segment is Segment.GROUND or len(topology.segments) > 1,
            device=SIMULATED if is_simulated(joystick) else joystick,
            answers_ns=round(setup.safety.hand_max_age_s * NS_PER_S) + setup.round_trip_ns,
        )


class EndKnowledge:
    """Hand over what joystick, robot, panel and experiment tell, then ask for `known`.

    status, robot: the newest of joystick and robot, whichever this end hears.
    """

    def __init__(self, traits: EndTraits) -> None:
        self._traits = traits
        self.status: JoystickStatus | None = None
        self.robot: RobotStatus | None = None
        self._task: PanelShown | ExperimentShown | None = None
        self._heard_ns = 0
        #: Since when the dead-man button is held; None: it is not.
        self._held_ns: int | None = None
        #: Whether an emergency stop is kept on this machine, and who ordered it.
        self.stop: tuple[bool, str] = (False, "")

    def handle_told(
        self, told: JoystickStatus | RobotStatus | PanelShown | ExperimentShown, now_ns: int
    ) -> None:
        """What a process tells."""
        if isinstance(told, PanelShown | ExperimentShown):
            self._task = told
            return
        self._heard_ns = now_ns
        if isinstance(told, RobotStatus):
            self.robot = told
            return
        self.status = told
        if not told.held:
            self._held_ns = None
        elif self._held_ns is None:
            self._held_ns = now_ns

    @property
    def frozen(self) -> bool:
        """Whether a part of the operator's picture is frozen."""
        if self._traits.segment is Segment.GROUND:
            return self.robot is not None and self.robot.blind
        return self.status is not None and self.status.frozen

    def known(
        self, role: Role, now_ns: int, *, connected: bool, runs: bool = True, holder: str = ""
    ) -> Known:
        """What is known, for a role at this end."""
        traits, task = self._traits, self._task
        known = Known(
            seat=traits.segment,
            role=role,
            orders=traits.orders,
            runs=runs,
            connected=connected,
            device=traits.device,
            holder=holder,
        )
        if isinstance(task, ExperimentShown):
            offered = next((one.name for one in task.tasks if not one.lacks), "")
            known = replace(known, panel=task.phase, offered=offered)
        elif task is not None:
            known = replace(known, panel=task.mode, panel_words=task.words)
        fresh = now_ns - self._heard_ns < _HEARD_NS
        if traits.segment is Segment.GROUND:
            return self._with_robot(known, fresh=fresh)
        return self._with_joystick(known, now_ns, fresh=fresh)

    def _with_joystick(self, known: Known, now_ns: int, *, fresh: bool) -> Known:
        """What space knows of joystick and robot."""
        status, stop, answers_ns = self.status, self.stop, self._traits.answers_ns
        if status is None:
            return replace(known, joystick=None, stopped=stop[0], by=stop[1], answered=False)
        late = status.command_age_ms is not None and status.command_age_ms * NS_PER_MS > answers_ns
        return replace(
            known,
            stopped=stop[0] or status.robot_stopped,
            answered=status.robot_stopped,
            by=stop[1],
            joystick=JoystickState(status.state).words if fresh else None,
            says=status.reason,
            request=status.request,
            testing=status.test == Outcome.RUNNING.value,
            held=status.held,
            taken_up=self._held_ns is None or now_ns - self._held_ns > answers_ns,
            russian=status.experiment is ExperimentName.RUSSIAN,
            drive=status.drive,
            waits=status.robot_waits,
            barred=Hold.PICTURE
            if status.blind or status.frozen
            else Hold.AGE
            if late
            else Hold.NONE,
        )

    def _with_robot(self, known: Known, *, fresh: bool) -> Known:
        """What the ground knows of the robot."""
        robot, stop = self.robot, self.stop
        if robot is None:
            return replace(known, drive="", stopped=stop[0], by=stop[1], answered=False)
        telepresence = robot.mode is ControlMode.TELEPRESENCE
        drive: Drive = "off" if not robot.powered else "hand" if telepresence else "own"
        return replace(
            known,
            stopped=stop[0] or robot.stopped,
            answered=robot.stopped,
            by=stop[1] or robot.stopped_by,
            drive=drive if fresh else "",
            telepresence=telepresence,
            fault=robot.fault,
            barred=Hold(robot.barred),
            waits=robot.waiting,
            cause=robot.hold,
            partner=robot.partner == "driven",
        )

"""A mission's ground side: experiment, LED panel, plan, and the rows of the report. A core."""

from collections import deque
from collections.abc import Iterable
from dataclasses import asdict, dataclass, field, replace

import msgspec

from pipelines.session.mission_messages import (
    ExperimentShown,
    RobotOrder,
    RobotStatus,
    RunShown,
    StepShown,
    TaskListed,
)
from pipelines.session.task_journal import LinkMeanwhile, TaskJournal, TaskRow
from telepresence.tasks.definitions import Catalogue
from telepresence.tasks.experiment import Experiment, Logged, Phase, RunStep, TaskRun
from telepresence.tasks.kernel import (
    ChooseCamera,
    ControlRobot,
    MoveRobot,
    Order,
    OtherHand,
    PowerRobot,
    Record,
    ShowPicture,
    View,
)
from telepresence.tasks.panel_picture import DARK, PanelSender
from telepresence.tasks.plan import PlanFollower, SessionPlan, TaskWorld
from telepresence.tmtc.k2aci import K2aciMessage, TaskFinished, TaskResult

_MOST_STEPS, _MOST_RUNS = 40, 20
_KILLED = "the task's process was restarted"


@dataclass(frozen=True, kw_only=True)
class TaskOptions:
    """Which tasks there are, who selects them, and where the LED panel is (None: built in).

    plan: None: people select. runs: directory for one recording of each run. simulated: a simulated
    cosmonaut does them. world: what is there to do them with.
    """

    catalogue: Catalogue
    plan: SessionPlan | None = None
    leds: tuple[str, int] | None = None
    runs: str | None = None
    simulated: bool = False
    world: TaskWorld = field(default_factory=TaskWorld)


@dataclass(frozen=True, kw_only=True, slots=True)
class Seen:
    """What the ground sees at a tick. camera: the selected one. link: for the report. other: the
    hand of the partner's arm, None without one that the robot's can meet. exercise: a trainer lets
    each task fail.
    """

    robot: RobotStatus
    camera: str
    recording: bool
    signal: bool
    link: LinkMeanwhile
    other: OtherHand | None = None
    exercise: bool = False


def listed_tasks(catalogue: Catalogue, world: TaskWorld) -> tuple[TaskListed, ...]:
    """All tasks, and why some of them cannot be done in this world."""
    return tuple(
        TaskListed(task.name, task.text, world.lacks(task)) for task in catalogue.tasks.values()
    )


class MissionMemory(msgspec.Struct, frozen=True, kw_only=True):
    """What outlives the process: number of the next run, the run that is not over, all rows.

    planned: runs of the plan that have finished, or that somebody on the ground has ended.

    Instants are those of the session's clock.
    """

    next_run: int = 1
    task: str = ""
    run: int = 0
    selected_ns: int = 0
    started_ns: int | None = None
    planned: int = 0
    rows: tuple[TaskRow, ...] = ()


class MissionGround:
    """Call `handle_tick` ten times a second.

    After each input carry out `poll_order`'s orders, send `poll_message`'s messages, and keep
    `memory`. A new start that is given the memory of a run ends it as aborted.

    plan: what is selected, and when; None: people do that.
    world: what is there to do them with.
    first_number: of the LED panel's datagrams, as of `PanelSender`.
    """

    def __init__(
        self,
        catalogue: Catalogue,
        plan: SessionPlan | None,
        *,
        now_ns: int,
        memory: MissionMemory | None = None,
        first_number: int = 0,
        world: TaskWorld | None = None,
    ) -> None:
        self._catalogue = catalogue
        memory = memory or MissionMemory()
        self.experiment = Experiment(catalogue, first_run=memory.next_run)
        self.leds = PanelSender(first_number=first_number)
        self.journal = TaskJournal(memory.rows)
        self._names = tuple(catalogue.tasks)
        self._listed = listed_tasks(catalogue, world or TaskWorld())
        self._follower = None if plan is None else PlanFollower(plan, finished=memory.planned)
        self._next_run = memory.next_run
        #: Somebody on the ground has ended the present run, so that the plan goes on.
        self._aborted = False
        self._run: Logged | None = None
        self._started_ns: int | None = None
        self._link = LinkMeanwhile(0, 0, 0)
        self._orders: deque[Order] = deque()
        self._messages: deque[K2aciMessage] = deque()
        self._steps: deque[StepShown] = deque(maxlen=_MOST_STEPS)
        self._runs: deque[RunShown] = deque(maxlen=_MOST_RUNS)
        if memory.run:
            self._end_earlier(memory, now_ns)

    @property
    def memory(self) -> MissionMemory:
        """What a next start needs."""
        run = self._run
        return MissionMemory(
            next_run=self._next_run,
            task="" if run is None else run.task,
            run=0 if run is None else run.run,
            selected_ns=0 if run is None else run.now_ns,
            started_ns=self._started_ns,
            planned=0 if self._follower is None else self._follower.finished,
            rows=self.journal.closed,
        )

    @property
    def shown(self) -> ExperimentShown:
        """What the seats see."""
        status = self.experiment.status
        return ExperimentShown(
            **asdict(status),
            tasks=self._listed,
            steps=tuple(self._steps),
            runs=tuple(self._runs),
            planned=self._follower is not None,
        )

    @property
    def telemetry(self) -> dict[str, int | float | bool | str]:
        """The parameters of the application `tasks`; task: that of the newest run."""
        status = self.experiment.status
        values: dict[str, int | float | bool | str] = {
            "phase": status.phase.value,
            "run": status.run,
        }
        for row in self.journal.newest(1):
            values["task"] = self._names.index(row.name)
        return values

    def handle_function(self, name: str, arguments: Iterable[object], now_ns: int) -> str:
        """A telecommand: "select" with an index, "start" or "abort"; why it is refused, or ""."""
        if name == "select":
            (index,) = arguments
            if not isinstance(index, int) or not 0 <= index < len(self._names):
                return f"no task {index}: there are 0 to {len(self._names) - 1}"
            return self._select(self._names[index], now_ns)
        if name == "start":
            refusal = self.experiment.start(now_ns)
        elif self.experiment.status.phase is Phase.IDLE:
            refusal = "no task is being done"
        else:
            refusal = ""
            self._aborted = True
            self.experiment.abort("somebody on the ground ended it", now_ns)
        self._settle(now_ns)
        return refusal

    def handle_message(self, message: K2aciMessage, now_ns: int) -> None:
        self.experiment.handle_message(message, now_ns)
        self._settle(now_ns)

    def handle_tick(self, seen: Seen, now_ns: int) -> None:
        """A tenth of a second has passed."""
        experiment, self._link = self.experiment, seen.link
        if self._follower is not None:
            idle = experiment.status.phase is Phase.IDLE
            wanted = self._follower.poll_select(idle=idle, signal=seen.signal, now_ns=now_ns)
            if wanted is not None:
                self._select(wanted, now_ns)
        if seen.exercise:
            # A trainee is not told that it is an exercise.
            experiment.abort("the robot application has a fault", now_ns)
        robot = seen.robot
        view = View(
            powered=robot.powered,
            mode=robot.mode,
            x_m=robot.x_m,
            y_m=robot.y_m,
            push_n=robot.push_n,
            holds=robot.holds,
            other=seen.other,
            goal_m=robot.goal_m,
            fault=robot.fault,
            camera=seen.camera,
            shown=self.leds.shown,
            recording=seen.recording,
            signal=seen.signal,
            halted=robot.halted,
        )
        experiment.handle_view(view, now_ns)
        self._settle(now_ns)
        if experiment.status.phase is Phase.RUNNING:
            elemop, picture = experiment.kernel.elemop, self.leds.picture
            other_n = None if seen.other is None else seen.other.push_n
            place = robot.x_m, robot.y_m, robot.push_n
            self.journal.keeper.handle_robot(*place, elemop, picture, other_n)

    def poll_order(self) -> Order | None:
        """Return the next order to robot, camera or recorder, or None."""
        return self._orders.popleft() if self._orders else None

    def poll_message(self) -> K2aciMessage | None:
        return self._messages.popleft() if self._messages else None

    def _select(self, name: str, now_ns: int) -> str:
        if lacks := self._listed[self._names.index(name)].lacks:
            return f"task {name} {lacks}"
        refusal = self.experiment.select(name, now_ns)
        if not refusal:
            self.journal.handle_begin(self._link)
            self._next_run += 1
        self._settle(now_ns)
        return refusal

    def _settle(self, now_ns: int) -> None:
        experiment = self.experiment
        while (order := experiment.poll_transmit(now_ns)) is not None:
            if isinstance(order, ShowPicture):
                self.leds.show(order.picture, now_ns)
            else:
                self._orders.append(order)
        while (message := experiment.poll_message()) is not None:
            if isinstance(message, TaskFinished) and message.result is TaskResult.FINISHED:
                message = replace(message, reason=self.journal.keeper.words)
            self._messages.append(message)
        while (event := experiment.next_event()) is not None:
            self.journal.handle_event(event, self._link)
            if isinstance(event, Logged):
                # The panel shows the end after the run is over.
                if event.step is RunStep.SELECTED:
                    self._run, self._started_ns = event, None
                elif event.step is RunStep.STARTED:
                    self._started_ns = event.now_ns
                self._steps.append(StepShown(event.now_ns, event.run, event.task, event.step.value))
            elif isinstance(event, TaskRun):
                done = event.result is TaskResult.FINISHED or self._aborted
                if self._follower is not None and done:
                    self._follower.handle_finished()
                self._aborted = False
                self._run = None
                self._add_run(event)

    def _add_run(self, run: TaskRun) -> None:
        seconds = None if run.started_ns is None else (run.ended_ns - run.started_ns) / 1e9
        finished = run.result is TaskResult.FINISHED
        score = self.journal.keeper.words if finished else ""
        self._runs.append(RunShown(run.task, run.run, run.result.value, run.reason, seconds, score))

    def switch_off(self, now_ns: int) -> None:
        """End what an earlier start may have been doing; also where its memory was lost."""
        self._orders.extend((PowerRobot(False), Record(False)))
        self.leds.show(DARK, now_ns)

    def _end_earlier(self, memory: MissionMemory, now_ns: int) -> None:
        """A run of an earlier start: whatever it was doing is switched off."""
        run = TaskRun(
            task=memory.task,
            run=memory.run,
            result=TaskResult.ABORTED,
            reason=_KILLED,
            selected_ns=memory.selected_ns,
            started_ns=memory.started_ns,
            ended_ns=now_ns,
        )
        self.switch_off(now_ns)
        self._messages.append(
            TaskFinished(task=memory.task, run=memory.run, result=TaskResult.ABORTED)
        )
        self.journal.handle_event(run, self._link)
        self._add_run(run)


def robot_order(order: Order, number: int) -> RobotOrder | None:
    """Return an order of the kernel for the robot's process; None if it is for others."""
    if isinstance(order, PowerRobot):
        return RobotOrder(number, "power", on=order.on)
    if isinstance(order, ControlRobot):
        return RobotOrder(number, "mode", mode=order.mode)
    if isinstance(order, MoveRobot):
        return RobotOrder(number, "move", x_m=order.x_m, y_m=order.y_m)
    assert isinstance(order, ChooseCamera | Record)
    return None

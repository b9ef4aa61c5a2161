"""A session plan: which tasks an experimenter selects, one after the other. A core."""

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice

from kontur_av.clock import NS_PER_S
from kontur_av.errors import ConfigError
from telepresence.tasks.definitions import Catalogue, Task

#: Between a contact or the end of a run, and the next selection.
PAUSE_NS = 3 * NS_PER_S
_MOST_REPEATS = 1000
#: Why a task of two hands is refused.
NEEDS_TWO_HANDS = (
    'needs two hands that meet: a session with partner_arm = "second", and a robot that says so '
    "(--robot, --second-robot)"
)


NEEDS_FORCE = "needs a robot that measures the force of its surroundings (--robot)"


@dataclass(frozen=True, kw_only=True, slots=True)
class TaskWorld:
    """What is there to do tasks with.

    cameras: of the setup `setup`; None: any. two_hands: the robot's hand can meet that of the
    partner's arm. measures: the robot measures the force of its surroundings.
    """

    cameras: tuple[str, ...] | None = None
    setup: str = ""
    two_hands: bool = False
    measures: bool = True

    def lacks(self, task: Task) -> str:
        """Return why a task cannot be done here, as what "it" needs; "" if it can."""
        if task.two_handed and not self.two_hands:
            return NEEDS_TWO_HANDS
        if task.by_force and not self.measures:
            return NEEDS_FORCE
        for camera in () if self.cameras is None else task.cameras:
            if camera not in (cameras := self.cameras or ()):
                return (
                    f"selects the camera {camera}, and setup {self.setup} has "
                    f"{', '.join(cameras)}: take another setup, or give it the camera"
                )
        return ""


@dataclass(frozen=True, kw_only=True, slots=True)
class PlannedTask:
    """A task by its name, and how often it is done. ConfigError for 0 times or more than 1000."""

    name: str
    repeat: int = 1

    def __post_init__(self) -> None:
        if not 1 <= self.repeat <= _MOST_REPEATS:
            raise ConfigError(
                f"task {self.name}: repeat is {self.repeat}: give 1 to {_MOST_REPEATS}"
            )


@dataclass(frozen=True, kw_only=True, slots=True)
class SessionPlan:
    """tasks: in their order. again: begin anew after the last. skill: of a simulated cosmonaut,
    0 to 1. ConfigError for a plan without tasks."""

    tasks: tuple[PlannedTask, ...]
    again: bool = False
    skill: float = 0.7

    def __post_init__(self) -> None:
        if not self.tasks:
            raise ConfigError("a plan has at least one [[task]]")
        if not 0.0 <= self.skill <= 1.0:
            raise ConfigError(f"skill is {self.skill:g}: give 0, a beginner, to 1, trained")

    def check(self, catalogue: Catalogue, world: TaskWorld) -> None:
        """ConfigError for a task that is unknown, or cannot be done there."""
        for planned in self.tasks:
            if lacks := world.lacks(catalogue.task(planned.name)):
                raise ConfigError(f"task {planned.name} {lacks}")

    def names(self) -> Iterator[str]:
        """The tasks, as often as they are done."""
        while True:
            for planned in self.tasks:
                yield from (planned.name for _ in range(planned.repeat))
            if not self.again:
                return


class PlanFollower:
    """Says when to select which task: `poll_select` ten times a second.

    A run that does not finish is repeated. Say `handle_finished` after one that does.

    finished: the number of planned runs that have finished.
    """

    def __init__(self, plan: SessionPlan, *, finished: int = 0) -> None:
        self.finished = finished
        self._names = islice(plan.names(), finished, None)
        self._name = next(self._names, None)
        self._free_ns: int | None = None

    def poll_select(self, *, idle: bool, signal: bool, now_ns: int) -> str | None:
        """The task to select now, or None. idle: no task is being done. signal: the link is up."""
        if not idle or not signal:
            self._free_ns = None
            return None
        if self._free_ns is None:
            self._free_ns = now_ns
        if now_ns - self._free_ns < PAUSE_NS:
            return None
        self._free_ns = None
        return self._name

    def handle_finished(self) -> None:
        """The selected task has been finished."""
        self.finished += 1
        self._name = next(self._names, None)

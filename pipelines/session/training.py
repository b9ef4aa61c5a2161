"""A trainer's exercises: a loss of signal, faults, a lost camera, failed tasks. A core.

An exercise lasts until an instant of the session's clock. All of them are in one sample of a topic,
so a process that is started again finds those that still last.
"""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite
from typing import Final

import msgspec

from kontur_av.clock import NS_PER_S
from kontur_av.errors import ConfigError
from pipelines.session.probe import Probe
from pipelines.session.session_metrics import DatedEvent, TrainerMetrics
from pipelines.session.setup.segments import Segment
from pipelines.session.setup.table import VideoStream
from pipelines.session.topic import Topic
from pipelines.session.topology.table import Topology

#: The name of the trainer's socket.
TRAINER_SOCKET = "trainer"
LOS, JOYSTICK, ROBOT = "los", "joystick-error", "robot-fault"
TASK, CAMERA, END = "task-failed", "camera-lost", "end"
#: By exercise: what it does, and how long it lasts by default (s).
EXERCISES: Mapping[str, tuple[str, float]] = {
    LOS: ("no frame gets through, either way", 20.0),
    JOYSTICK: ("the joystick has a fault, and recovers afterwards", 5.0),
    ROBOT: ("the robot has a fault and is off; afterwards the fault can be reset", 5.0),
    TASK: ("each task fails", 1.0),
    CAMERA: ("a camera gives no pictures", 10.0),
}
#: An exercise is no longer than this.
LONGEST_S = 3600.0
#: How many events are kept for the report.
_DEPTH = 200
#: A lasting state is published again, for a process that was started after the last change.
_REPEAT_NS: Final = NS_PER_S


class Exercises(msgspec.Struct, frozen=True, kw_only=True, array_like=True):
    """What lasts, until when on the session's clock; an instant in the past: it is over.

    los_ns: no frame gets through, either way. joystick_ns, robot_ns: joystick or robot has a fault.
    tasks_ns: each task fails. cameras_ns: by input, until when it gives no pictures.
    """

    los_ns: int = 0
    joystick_ns: int = 0
    robot_ns: int = 0
    tasks_ns: int = 0
    cameras_ns: Mapping[str, int] = {}


TRAINER_TOPIC = Topic[Exercises](
    "trainer/exercises", Exercises, "until when a trainer's exercises last"
)


class TrainerRequest(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """What a terminal asks. seconds: how long. camera: the name of an input."""

    exercise: str
    seconds: float = 0.0
    camera: str = ""


class TrainerAnswer(msgspec.Struct, frozen=True, tag=True):
    """It is done. text: what."""

    text: str


@dataclass(frozen=True, kw_only=True, slots=True)
class TrainerReach:
    """What a trainer can make fail. radio, joystick, robot, tasks: whether these are here.

    cameras: the inputs with pictures that are here. across: the ground is across the radio, and is
    asked by telecommand for what is there.
    """

    radio: bool
    joystick: bool
    robot: bool
    tasks: bool = False
    cameras: tuple[str, ...] = ()
    across: bool = False

    @classmethod
    def of(cls, topology: Topology) -> "TrainerReach":
        """What the trainer of a session reaches."""
        ground = Segment.GROUND in topology.segments
        cameras = (
            row.name
            for row in topology.inputs
            if topology.runs(row.process)
            and isinstance(topology.media(row.stream).stream, VideoStream)
        )
        return cls(
            radio=topology.alone is not Segment.GROUND,
            joystick=Segment.SPACE in topology.segments,
            robot=ground,
            tasks=ground and topology.options.tasks,
            cameras=tuple(cameras),
            across=topology.alone is Segment.SPACE,
        )

    def asks_ground(self, exercise: str) -> bool:
        """Whether the ground is asked for an exercise, because robot and tasks are there."""
        return self.across and exercise in (ROBOT, TASK)

    def lacks(self, exercise: str, camera: str) -> str:
        """Why an exercise cannot be here, in one line; "" if it can."""
        if self.asks_ground(exercise):
            return ""
        here = {LOS: self.radio, JOYSTICK: self.joystick, ROBOT: self.robot}
        if not here.get(exercise, True):
            part = {LOS: "radio", JOYSTICK: "joystick", ROBOT: "robot"}[exercise]
            return f"the {part} is at the other end: ask there"
        if exercise == TASK and not self.tasks:
            return "no tasks are here: they are at the ground's end, with --tasks"
        if exercise == CAMERA and camera not in self.cameras:
            known = ", ".join(self.cameras) or "none"
            return f"no camera {camera} is here: here are {known}"
        return ""


class Trainer:
    """Turns requests into `exercises`. reach: what is here.

    exercises: what lasts at present; a new object after each change.
    """

    def __init__(self, probe: Probe, reach: TrainerReach) -> None:
        self.exercises = Exercises()
        self._probe, self._reach = probe, reach
        self._events: deque[DatedEvent] = deque(maxlen=_DEPTH)
        self._asked: deque[tuple[str, tuple[float, ...]]] = deque()
        self._published = self.exercises
        self._due_ns = 0

    def handle_request(self, request: TrainerRequest, now_ns: int) -> TrainerAnswer:
        """Begin an exercise, or end all; ConfigError for what cannot be."""
        if wrong := self._mistake(request):
            raise ConfigError(wrong)
        until_ns = now_ns + round(request.seconds * NS_PER_S)
        if request.exercise == END:
            self.exercises, text = Exercises(), "all exercises ended"
            if self._reach.across:
                self._asked.append((END, ()))
        elif self._reach.asks_ground(request.exercise):
            self._asked.append((request.exercise.replace("-", "_"), (request.seconds,)))
            text = f"{request.exercise} for {request.seconds:g} s: the ground is asked"
        else:
            changes: dict[str, tuple[str, object, str]] = {
                LOS: ("los_ns", until_ns, "no signal"),
                JOYSTICK: ("joystick_ns", until_ns, "joystick error"),
                ROBOT: ("robot_ns", until_ns, "robot fault"),
                TASK: ("tasks_ns", until_ns, "tasks fail"),
                CAMERA: (
                    "cameras_ns",
                    {**self.exercises.cameras_ns, request.camera: until_ns},
                    f"{request.camera} gives no pictures",
                ),
            }
            field, value, words = changes[request.exercise]
            self.exercises = msgspec.structs.replace(self.exercises, **{field: value})
            text = f"{words} for {request.seconds:g} s"
        self._events.append(DatedEvent(at_ns=now_ns, what=text))
        return TrainerAnswer(text)

    def poll_exercises(self, now_ns: int) -> Exercises | None:
        """Return what to publish now, or None: each change, and again for processes that began."""
        if self.exercises is self._published and now_ns < self._due_ns:
            return None
        self._published, self._due_ns = self.exercises, now_ns + _REPEAT_NS
        return self.exercises

    def next_asked(self) -> tuple[str, tuple[float, ...]] | None:
        """The next function of the ground's trainer to call, with its arguments; or None."""
        return self._asked.popleft() if self._asked else None

    def handle_answered(self, function: str, refusal: str, now_ns: int) -> None:
        """The ground has begun it, or says why not."""
        words = f"the ground refuses it: {refusal}" if refusal else "the ground does it"
        self._events.append(DatedEvent(at_ns=now_ns, what=f"{function}: {words}"))

    def publish(self) -> None:
        """Put what was done into the probe."""
        self._probe.publish(TrainerMetrics(exercises=tuple(self._events)))

    def _mistake(self, request: TrainerRequest) -> str:
        """Why a request cannot be, in one line; "" if it can."""
        exercise, seconds = request.exercise, request.seconds
        if exercise not in (*EXERCISES, END):
            return f"no exercise {exercise}: take {', '.join(EXERCISES)} or {END}"
        if exercise != END and not (isfinite(seconds) and 0 < seconds <= LONGEST_S):
            return f"{seconds:g} s: take more than 0 and at most {LONGEST_S:g}"
        return self._reach.lacks(exercise, request.camera)

"""A trainer's exercises: a loss of signal, faults, a lost camera. A core.

Requests of terminals are lines of JSON, such as `{"exercise": "los", "seconds": 20}`. The answer is
`{"ok": true, "text": "..."}` or `{"ok": false, "text": "..."}`.

An exercise lasts until an instant of the session's clock. All of them are in one sample of a topic,
so a process that is started again finds those that still last.
"""

from collections import deque
from collections.abc import Mapping, Sequence
from math import isfinite

import msgspec

from kontur_av.clock import NS_PER_S
from pipelines.session.figures import DatedEvent, TrainerFigures
from pipelines.session.probe import Probe
from pipelines.session.terminal_lines import LineDesk

#: The name of the trainer's Unix socket.
TRAINER_DESK = "trainer"
LOS, JOYSTICK, ROBOT = "los", "joystick-error", "robot-fault"
CAMERA, END = "camera-lost", "end"
#: An exercise is no longer than this.
LONGEST_S = 3600.0
#: How many events are kept for the report.
_DEPTH = 200


class Exercises(msgspec.Struct, frozen=True, kw_only=True, array_like=True):
    """What lasts, until when on the session's clock; an instant in the past: it is over.

    los_ns: no frame gets through, either way. joystick_ns, robot_ns: joystick or robot has a fault.
    cameras_ns: by input, until when it gives no pictures.
    """

    los_ns: int = 0
    joystick_ns: int = 0
    robot_ns: int = 0
    cameras_ns: Mapping[str, int] = {}

    def pack(self) -> bytes:
        return msgspec.msgpack.encode(self)

    @classmethod
    def unpack(cls, octets: bytes) -> "Exercises":
        """Return what `pack` packed. Only the session's own trainer writes the topic."""
        return msgspec.msgpack.decode(octets, type=cls)


class TrainerRequest(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """What a terminal asks. seconds: how long. camera: the name of an input."""

    exercise: str
    seconds: float = 0.0
    camera: str = ""


class TrainerAnswer(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """ok: it is done; else text says why not. mistake: the request itself was wrong."""

    ok: bool
    text: str
    mistake: bool = False


class Trainer:
    """Turns requests into `exercises`.

    radio: whether the radio of this session is here. joystick, robot: whether these are.
    cameras: the inputs with pictures that are here.

    desk: takes the requests. exercises: what lasts at present; a new object after each change.
    """

    def __init__(
        self, probe: Probe, *, radio: bool, joystick: bool, robot: bool, cameras: Sequence[str]
    ) -> None:
        self.exercises = Exercises()
        self._probe = probe
        self._radio, self._joystick, self._robot = radio, joystick, robot
        self._cameras = tuple(cameras)
        self.desk = LineDesk(TrainerRequest, self._answer)
        self._events: deque[DatedEvent] = deque(maxlen=_DEPTH)

    def tell(self) -> None:
        """Put what was done into the probe."""
        self._probe.tell(TrainerFigures(exercises=tuple(self._events)))

    def _answer(self, request: TrainerRequest, now_ns: int) -> TrainerAnswer:
        wrong = self._mistake(request)
        if wrong:
            return TrainerAnswer(ok=False, text=wrong, mistake=True)
        until_ns = now_ns + round(request.seconds * NS_PER_S)
        change = msgspec.structs.replace
        now, text = self.exercises, f"for {request.seconds:g} s"
        if request.exercise == LOS:
            self.exercises = change(now, los_ns=until_ns)
            text = f"no signal {text}"
        elif request.exercise == JOYSTICK:
            self.exercises = change(now, joystick_ns=until_ns)
            text = f"joystick error {text}"
        elif request.exercise == ROBOT:
            self.exercises = change(now, robot_ns=until_ns)
            text = f"robot fault {text}"
        elif request.exercise == CAMERA:
            cameras_ns = {**now.cameras_ns, request.camera: until_ns}
            self.exercises = change(now, cameras_ns=cameras_ns)
            text = f"{request.camera} gives no pictures {text}"
        else:
            self.exercises = Exercises()
            text = "all exercises ended"
        self._events.append(DatedEvent(at_ns=now_ns, what=text))
        return TrainerAnswer(ok=True, text=text)

    def _mistake(self, request: TrainerRequest) -> str:
        """Why a request cannot be, in one line; "" if it can."""
        exercise, seconds = request.exercise, request.seconds
        if exercise not in (LOS, JOYSTICK, ROBOT, CAMERA, END):
            return f"no exercise {exercise}: take {LOS}, {JOYSTICK}, {ROBOT}, {CAMERA} or {END}"
        if exercise != END and not (isfinite(seconds) and 0 < seconds <= LONGEST_S):
            return f"{seconds:g} s: take more than 0 and at most {LONGEST_S:g}"
        if exercise == LOS and not self._radio:
            return "the radio is at the other end: ask there"
        if exercise == JOYSTICK and not self._joystick:
            return "the joystick is at the other end: ask there"
        if exercise == ROBOT and not self._robot:
            return "the robot is at the other end: ask there"
        if exercise == CAMERA and request.camera not in self._cameras:
            known = ", ".join(self._cameras) or "none"
            return f"no camera {request.camera} is here: here are {known}"
        return ""

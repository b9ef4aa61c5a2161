"""What a task is made of: elementary operations (Elemops), operations, tasks, and their catalogue.

Task-oriented programming: M. Stelzer et al., "Software Architecture and Design of the Kontur-2
Mission", IEEE Aerospace Conference 2017, section 7. A task has two operations: `start`, which the
experimenter activates on the ground, and `exec`, which the cosmonaut activates on board. An
operation is a sequence of Elemops; each has an end condition and a time-out.

The fields of an Elemop are the attributes of its XML element. Lengths are in millimetres, in the
coordinates of the task board (`telepresence.haptics.board`).
"""

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Any

from kontur_av.errors import ConfigError


class ControlMode(StrEnum):
    """How the robot's joints are controlled. In telepresence the cosmonaut's hand leads it.

    In impedance a spring and a damper hold the tip, so that it yields to what it touches.
    """

    POSITION = "position"
    TORQUE = "torque"
    TELEPRESENCE = "telepresence"
    IMPEDANCE = "impedance"


#: In these an interpolator leads the robot to a place.
MOVING_MODES = (ControlMode.POSITION, ControlMode.IMPEDANCE)


class Pattern(StrEnum):
    """What the LED panel shows. leds: those of a mask. spot: a light at a place."""

    DARK = "dark"
    LEDS = "leds"
    SPOT = "spot"
    CONTOUR = "contour"
    LINE = "line"
    SPRING = "spring"
    FREE = "free"


class SpotPath(StrEnum):
    """The way of the moving spot."""

    CIRCLE = "circle"
    EIGHT = "eight"


class Curve(StrEnum):
    """What the stylus can follow."""

    CONTOUR = "contour"
    LINE = "line"


class Hands(StrEnum):
    """Whose hand: the robot's, or that of the partner's arm."""

    ROBOT = "robot"
    PARTNER = "partner"


#: The longest time that anything in a task may take (s).
LONGEST_S = 600.0


def _within(default: Any, least: float, most: float) -> Any:
    return field(default=default, metadata={"least": least, "most": most})


def _needed(least: float, most: float) -> Any:
    return field(metadata={"least": least, "most": most})


@dataclass(frozen=True, kw_only=True, slots=True)
class Elemop:
    """name: by which operations refer to it. timeout_s: it ends the run as timed out."""

    name: str
    timeout_s: float = _within(10.0, 0.1, LONGEST_S)


@dataclass(frozen=True, kw_only=True, slots=True)
class SetPower(Elemop):
    """Switch the robot on or off. Ends when it is."""

    on: bool


@dataclass(frozen=True, kw_only=True, slots=True)
class SetMode(Elemop):
    """Choose the control mode for the next power on. Ends when it is chosen."""

    mode: ControlMode


@dataclass(frozen=True, kw_only=True, slots=True)
class SelectCamera(Elemop):
    """Select the uplink video's camera. Ends when it is selected."""

    camera: str


@dataclass(frozen=True, kw_only=True, slots=True)
class Show(Elemop):
    """Draw a pattern on the LED panel. Ends when the panel has acknowledged it.

    leds: numbers 0 to 7, for the pattern `leds`.
    """

    pattern: Pattern = Pattern.LEDS
    leds: tuple[int, ...] = _within((), 0, 7)


@dataclass(frozen=True, kw_only=True, slots=True)
class MoveTo(Elemop):
    """Move the tip there, in position or impedance control. Ends when it rests within 2 mm."""

    x_mm: float = _within(0.0, -150, 150)
    y_mm: float = _within(0.0, -100, 100)


@dataclass(frozen=True, kw_only=True, slots=True)
class StartLog(Elemop):
    """Start to record. Ends when the recorder says so."""


@dataclass(frozen=True, kw_only=True, slots=True)
class StopLog(Elemop):
    """Stop to record. Ends when the recorder says so."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Reach(Elemop):
    """Ends when the tip was within `within_mm` of an LED for `hold_s`."""

    led: int = _needed(0, 7)
    within_mm: float = _within(5.0, 0.5, 50)
    hold_s: float = _within(0.5, 0, 60)
    timeout_s: float = _within(60.0, 0.1, LONGEST_S)


@dataclass(frozen=True, kw_only=True, slots=True)
class Pursue(Elemop):
    """The spot moves on its path. Ends when it has moved for `seconds`."""

    path: SpotPath = SpotPath.CIRCLE
    seconds: float = _within(20.0, 1, LONGEST_S)
    turn_s: float = _within(10.0, 2, 60)
    timeout_s: float = _within(LONGEST_S, 0.1, LONGEST_S)


@dataclass(frozen=True, kw_only=True, slots=True)
class Follow(Elemop):
    """Ends when the tip was within `within_mm` of `share` of the curve."""

    curve: Curve
    within_mm: float = _within(6.0, 0.5, 50)
    share: float = _within(0.95, 0.05, 1)
    timeout_s: float = _within(120.0, 0.1, LONGEST_S)


@dataclass(frozen=True, kw_only=True, slots=True)
class Pull(Elemop):
    """Ends when the spring was held at `force_n`, give or take `within_n`, for `hold_s`."""

    force_n: float = _within(3.0, 0.2, 6)
    within_n: float = _within(0.8, 0.05, 5)
    hold_s: float = _within(1.0, 0, 60)
    timeout_s: float = _within(60.0, 0.1, LONGEST_S)


@dataclass(frozen=True, kw_only=True, slots=True)
class Meet(Elemop):
    """Ends when robot and partner's arm pushed each other for `hold_s`, each with `force_n` or
    more, and their tips were within `within_mm`.
    """

    force_n: float = _within(1.0, 0.2, 6)
    within_mm: float = _within(50.0, 0.5, 50)
    hold_s: float = _within(0.3, 0, 60)
    timeout_s: float = _within(60.0, 0.1, LONGEST_S)


@dataclass(frozen=True, kw_only=True, slots=True)
class HoldBall(Elemop):
    """Ends when this hand alone held the ball for `hold_s`.

    x_mm, y_mm: where the ball lies while no hand holds it.
    """

    hand: Hands
    x_mm: float = _within(0.0, -150, 150)
    y_mm: float = _within(0.0, -100, 100)
    hold_s: float = _within(0.5, 0, 60)
    timeout_s: float = _within(60.0, 0.1, LONGEST_S)


@dataclass(frozen=True, kw_only=True, slots=True)
class Wait(Elemop):
    """Ends after `seconds`."""

    seconds: float = _needed(0, LONGEST_S)
    timeout_s: float = _within(LONGEST_S, 0.1, LONGEST_S)


#: XML element -> class. The element's name is the class's.
ELEMOPS: dict[str, type[Elemop]] = {
    kind.__name__: kind
    for kind in (
        SetPower,
        SetMode,
        SelectCamera,
        Show,
        MoveTo,
        StartLog,
        StopLog,
        Reach,
        Pursue,
        Follow,
        Pull,
        Meet,
        HoldBall,
        Wait,
    )
}


@dataclass(frozen=True, slots=True)
class Operation:
    """A sequence of Elemops; operations within it are already put in their place."""

    name: str
    elemops: tuple[Elemop, ...]


@dataclass(frozen=True, kw_only=True, slots=True)
class Task:
    """What an experimenter selects.

    start, exec: its two operations. start_x_mm, start_y_mm: where handle and tip begin.
    text: tells the cosmonaut what to do; one line, at most 128 octets.
    """

    name: str
    start: Operation
    exec: Operation
    start_x_mm: float
    start_y_mm: float
    text: str

    @property
    def cameras(self) -> tuple[str, ...]:
        """The cameras that it selects, in their order."""
        steps = (*self.start.elemops, *self.exec.elemops)
        return tuple(dict.fromkeys(op.camera for op in steps if isinstance(op, SelectCamera)))

    @property
    def two_handed(self) -> bool:
        """Whether it needs the partner's arm, too."""
        return any(isinstance(op, Meet | HoldBall) for op in self.exec.elemops)

    @property
    def by_force(self) -> bool:
        """Whether it ends by a force that the robot measures."""
        return any(isinstance(op, Meet | Pull) for op in self.exec.elemops)


@dataclass(frozen=True, slots=True)
class Catalogue:
    """All that is defined, by name."""

    elemops: dict[str, Elemop] = field(default_factory=dict)
    operations: dict[str, Operation] = field(default_factory=dict)
    tasks: dict[str, Task] = field(default_factory=dict)

    def task(self, name: str) -> Task:
        """The task of this name; ConfigError names those that exist."""
        if name not in self.tasks:
            raise ConfigError(f"unknown task {name}: choose one of {', '.join(self.tasks)}")
        return self.tasks[name]

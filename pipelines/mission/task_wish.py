"""What a session's options wish of tasks."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from pipelines.session.topology import JOYSTICK, PAGES, TASKS, Segment
from telepresence.tasks.definitions import Catalogue
from telepresence.tasks.plan import SessionPlan


@dataclass(frozen=True, kw_only=True)
class TaskWish:
    """Which tasks there are, who selects them, and where the LED panel is (None: built in).

    runs: directory for one recording of each run. simulated: a simulated cosmonaut does them.
    two_hands: the robot's hand can meet that of the partner's arm.
    """

    catalogue: Catalogue
    plan: SessionPlan | None
    leds: tuple[str, int] | None
    runs: Path | None
    simulated: bool
    two_hands: bool


def task_arguments(wish: TaskWish | None) -> Mapping[str, Mapping[str, object]]:
    """By process, what it needs to know of the wish."""
    if wish is None:
        return {}
    arguments: dict[str, dict[str, object]] = {
        TASKS: {
            "plan": wish.plan,
            "catalogue": wish.catalogue,
            "leds": wish.leds,
            "two_hands": wish.two_hands,
            "runs": None if wish.runs is None else str(wish.runs.resolve()),
        },
        PAGES[Segment.SPACE]: {"tasks": wish.catalogue},
    }
    if wish.simulated and wish.plan is not None:
        arguments[JOYSTICK] = {"skill": wish.plan.skill}
    return arguments

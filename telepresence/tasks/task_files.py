"""Loads the built-in catalogue, users' files of tasks, and session plans. A shell."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path

from kontur_av.errors import ConfigError, refused
from telepresence.tasks.definitions import Catalogue
from telepresence.tasks.plan import PlannedTask, SessionPlan
from telepresence.tasks.reader import read_tasks
from telepresence.toml_file import read_toml, typed

#: The schema of a file of tasks, and the tasks that are built in.
SCHEMA = Path(__file__).with_name("tasks.xsd")
BUILT_IN = Path(__file__).with_name("catalogue.xml")


@cache
def built_in_tasks() -> Catalogue:
    return read_tasks(BUILT_IN.read_bytes())


def load_tasks(files: Sequence[Path] = ()) -> Catalogue:
    """The built-in catalogue and what `files` define; a ConfigError names file and line."""
    catalogue = built_in_tasks()
    for path in files:
        with refused(f"cannot read tasks {path}"):
            octets = path.read_bytes()
        try:
            catalogue = read_tasks(octets, catalogue)
        except ConfigError as error:
            raise ConfigError(f"tasks {path}, {error}") from None
    return catalogue


@dataclass(frozen=True, kw_only=True)
class _File:
    skill: float = 0.7
    again: bool = False
    files: tuple[str, ...] = field(
        default=(), metadata={"like": 'a list of texts, like ["mine.xml"]'}
    )
    task: tuple[PlannedTask, ...] = field(
        default=(), metadata={"like": "tables, each headed [[task]]"}
    )


def load_plan(path: Path) -> tuple[SessionPlan, Catalogue]:
    """The plan in a file, and the tasks that it may use. ConfigError names file and fix.

    skill = 0.7             # of the simulated cosmonaut
    again = true            # begin anew after the last task
    files = ["mine.xml"]    # further tasks; relative to this file
    [[task]]
    name = "aiming"
    repeat = 2
    """
    table = read_toml(path, "plan")
    with refused(f"plan {path}", ConfigError):
        entry = typed(table, _File, "a plan")
        catalogue = load_tasks([path.parent / name for name in entry.files])
        plan = SessionPlan(tasks=entry.task, again=entry.again, skill=entry.skill)
        for planned in plan.tasks:
            catalogue.task(planned.name)
    return plan, catalogue

"""One session of a campaign, and what became of it. A core."""

from dataclasses import dataclass

from pipelines.report.result import JsonReader
from pipelines.session.setup.table import Setup
from telepresence.tasks.definitions import Catalogue
from telepresence.tasks.plan import SessionPlan


@dataclass(frozen=True, kw_only=True)
class SessionTask:
    """A session on virtual time, whole: no file is needed to run it, but those of its sources.

    seconds: of virtual time. media: False leaves haptics and telecommands alone. plan: as of
    `pipelines.virtual.simulate.simulate`.
    """

    setup: Setup
    seconds: float
    seed: int
    media: bool = True
    plan: tuple[SessionPlan, Catalogue] | None = None


@dataclass(frozen=True, slots=True)
class SessionResult:
    """The report of a session. wall_s: how long it ran in real time."""

    report: JsonReader
    wall_s: float


@dataclass(frozen=True, slots=True)
class Crash:
    """A session without a report. error: its last words."""

    error: str


Result = SessionResult | Crash

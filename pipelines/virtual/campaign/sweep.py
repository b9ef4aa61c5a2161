"""A sweep: its cases, its runs, and the figures of each case over its seeds. A core."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from hashlib import sha256
from statistics import median
from typing import TYPE_CHECKING, TypeAlias

from pipelines.report.charts import COLOURS, new_figure
from pipelines.report.result import Headline
from pipelines.session.setup.table import Setup
from pipelines.virtual.campaign.campaign_metrics import (
    HEADINGS,
    METRICS,
    RunMetrics,
    SessionTask,
    task_names,
)
from telepresence.tasks.definitions import Catalogue
from telepresence.tasks.plan import SessionPlan

#: A value of a field, as a table shows it.
Value: TypeAlias = "int | float | str"


@dataclass(frozen=True, slots=True)
class Case:
    """One choice of values for the fields of a grid, and the setup that they make."""

    values: Mapping[str, Value]
    setup: Setup


@dataclass(frozen=True, kw_only=True)
class Sweep:
    """What a file asks for.

    seconds: of virtual time. plan: of the tasks in every session; None for none. fields: all that a
    grid varies. keys: of further figures in a report. x, y: the axes of the plot; x None: chosen by
    `x_field`.
    """

    name: str
    seconds: float
    seeds: Sequence[int]
    media: bool
    plan: tuple[SessionPlan, Catalogue] | None = None
    cases: Sequence[Case]
    fields: Sequence[str]
    keys: Sequence[str]
    x: str | None
    y: str

    @property
    def metrics(self) -> list[str]:
        tasks = task_names(None if self.plan is None else self.plan[0])
        return [*(figure.name for figure in METRICS), *tasks, *self.keys]

    def tasks(self) -> list[SessionTask]:
        """All runs: case by case, and in each its seeds."""
        return [
            SessionTask(
                setup=case.setup, seconds=self.seconds, seed=seed, media=self.media, plan=self.plan
            )
            for case in self.cases
            for seed in self.seeds
        ]

    @property
    def x_field(self) -> str:
        """The field on the plot's axis: the first of numbers with several values, or the first."""
        if self.x is not None:
            return self.x
        for name in self.fields:
            values = {case.values.get(name) for case in self.cases} - {None}
            if len(values) > 1 and not any(isinstance(value, str) for value in values):
                return name
        return self.fields[0]


def task_key(task: SessionTask, keys: Sequence[str], code: str) -> str:
    """A digest of what decides the figures of a run. code: of the program's own text."""
    setup = task.setup
    radio, plan = setup.radio_profile, task.plan
    what = (setup, radio, task.seconds, task.seed, task.media, plan, tuple(keys), code)
    return sha256(repr(what).encode()).hexdigest()[:24]


@dataclass(frozen=True, slots=True, kw_only=True)
class SeedSpread:
    """A figure over the seeds of a case."""

    median: float
    least: float
    largest: float


@dataclass(frozen=True, kw_only=True)
class CaseMetrics:
    """A case over its seeds. runs: those that are over; usable: those without a fault."""

    values: Mapping[str, Value]
    runs: int
    usable: int
    faults: Mapping[str, int]
    metrics: Mapping[str, SeedSpread | None]


def case_metrics(sweep: Sweep, runs: Sequence[RunMetrics | None]) -> list[CaseMetrics]:
    """Each case. runs: in the order of `Sweep.tasks`; None for one that is not over."""
    seeds = len(sweep.seeds)
    found = []
    for number, case in enumerate(sweep.cases):
        over = [run for run in runs[number * seeds : (number + 1) * seeds] if run is not None]
        faults: dict[str, int] = {}
        for run in over:
            for fault in run.faults:
                faults[fault] = faults.get(fault, 0) + 1
        found.append(
            CaseMetrics(
                values=case.values,
                runs=len(over),
                usable=sum(not run.faults for run in over),
                faults=faults,
                metrics={name: _spread(over, name) for name in sweep.metrics},
            )
        )
    return found


def _spread(runs: Sequence[RunMetrics], name: str) -> SeedSpread | None:
    values = [value for run in runs if (value := run.metrics.get(name)) is not None]
    if not values:
        return None
    return SeedSpread(median=round(median(values), 3), least=min(values), largest=max(values))


def headings(sweep: Sweep, cases: Sequence[CaseMetrics]) -> list[str]:
    """Of the columns of `rows`: no column for a figure that no case has."""
    return [*sweep.fields, *(HEADINGS.get(name, name) for name in _had(sweep, cases)), "verdict"]


def rows(sweep: Sweep, cases: Sequence[CaseMetrics]) -> Iterator[list[str]]:
    """The cells of each case: a figure's median, with the least and the largest of its seeds."""
    had = _had(sweep, cases)
    for case in cases:
        yield [
            *(_text(case.values.get(name, "")) for name in sweep.fields),
            *(_cell(case.metrics[name]) for name in had),
            _verdict(case),
        ]


def _had(sweep: Sweep, cases: Sequence[CaseMetrics]) -> list[str]:
    return [name for name in sweep.metrics if any(case.metrics[name] for case in cases)]


def _cell(spread: SeedSpread | None) -> str:
    if spread is None:
        return ""
    if spread.least == spread.largest:
        return _text(spread.median)
    return f"{_text(spread.median)} ({_text(spread.least)} to {_text(spread.largest)})"


def _text(value: Value) -> str:
    return f"{value:.5g}" if isinstance(value, float) else str(value)


def _verdict(case: CaseMetrics) -> str:
    if not case.runs:
        return "not run"
    others = "".join(f", {count} {fault}" for fault, count in case.faults.items())
    return f"{case.usable} of {case.runs} usable{others}"


def csv_rows(sweep: Sweep, runs: Sequence[RunMetrics | None]) -> Iterator[list[Value]]:
    """A heading, then each run that is over: fields, seed, figures, verdict."""
    yield [*sweep.fields, "seed", *sweep.metrics, "verdict"]
    seeds = len(sweep.seeds)
    for number, run in enumerate(runs):
        if run is None:
            continue
        values = sweep.cases[number // seeds].values
        found = [run.metrics.get(name) for name in sweep.metrics]
        yield [
            *(values.get(name, "") for name in sweep.fields),
            run.seed,
            *("" if value is None else value for value in found),
            ", ".join(run.faults) or "usable",
        ]


def headlines(sweep: Sweep, cases: Sequence[CaseMetrics]) -> list[Headline]:
    """Each case for the page of measurements: usable runs, and the medians of its figures."""
    found = []
    for case in cases:
        group = ", ".join(f"{name} {_text(value)}" for name, value in case.values.items())
        found.append(
            Headline(
                group=group,
                what="usable runs",
                unit="%",
                value=100 * case.usable / max(1, case.runs),
                target="100",
                met=case.usable == case.runs == len(sweep.seeds),
            )
        )
        for name, spread in case.metrics.items():
            if spread is not None:
                what = f"{HEADINGS.get(name, name)}: median of the runs"
                found.append(Headline(group=group, what=what, unit="", value=spread.median))
    return found


if TYPE_CHECKING:
    from matplotlib.figure import Figure

#: More lines have no legend that can be read.
_MOST_NAMED = 16


def chart(sweep: Sweep, cases: Sequence[CaseMetrics]) -> "Figure":
    """Medians over the seeds, with bars from the least to the largest."""
    x, others = sweep.x_field, [name for name in sweep.fields if name != sweep.x_field]
    curves: dict[str, list[tuple[Value, SeedSpread]]] = {}
    for case in cases:
        spread = case.metrics[sweep.y]
        named = (name for name in others if name in case.values)
        label = ", ".join(f"{name} {case.values[name]}" for name in named)
        if spread is not None and x in case.values:
            curves.setdefault(label, []).append((case.values[x], spread))
    figure = new_figure(4.5)
    axes = figure.add_subplot()
    axes.set_xlabel(x)
    axes.set_ylabel(HEADINGS.get(sweep.y, sweep.y))
    title = f"{sweep.name}: {sweep.seconds:g} s, {len(sweep.seeds)} seeds"
    axes.set_title(title, fontsize="medium")
    axes.grid(alpha=0.4)
    if not curves:
        axes.text(0.5, 0.5, "nothing was measured", ha="center", transform=axes.transAxes)
        return figure
    places = list(dict.fromkeys(value for points in curves.values() for value, _ in points))
    worded = any(isinstance(value, str) for value in places)
    for number, (label, points) in enumerate(curves.items()):
        if not worded:
            points.sort(key=lambda point: float(point[0]))
        at = [float(places.index(value) if worded else value) for value, _ in points]
        middles = [spread.median for _, spread in points]
        below = [spread.median - spread.least for _, spread in points]
        above = [spread.largest - spread.median for _, spread in points]
        colour = COLOURS[number % len(COLOURS)]
        axes.errorbar(
            at, middles, yerr=[below, above], fmt="o-", capsize=3, color=colour, label=label
        )
    if worded:
        axes.set_xticks(range(len(places)), [str(value) for value in places])
    if len(curves) > 1:
        if len(curves) <= _MOST_NAMED:
            axes.legend(fontsize="small")
        else:
            axes.text(
                0.99, 0.98, f"{len(curves)} lines", ha="right", va="top", transform=axes.transAxes
            )
    return figure

"""What made a difference, and a page that says so. A core.

The analysis is one of variance with repeated measures.

Each participant's trials with a handle are one value, their mean. An effect is tested by
orthonormal contrasts of those values within participants, with an error of its own. Its degrees of
freedom are corrected after S. W. Greenhouse and S. Geisser ("On methods in the analysis of profile
data", Psychometrika 24, 1959). All tests of a report together are corrected after S. Holm (Scand.
J. Statist. 6, 1979): where nothing makes a difference, one report in twenty says that something
does.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from html import escape
from itertools import combinations, groupby
from math import sqrt

import numpy as np
from numpy.typing import NDArray

from pipelines.report.html_page import Bar, section, table, track, whole_page
from pipelines.study.plan import FACTORS, StudyPlan, TrialResult

#: What counts as a difference.
ALPHA = 0.05
#: Fewer participants tell nothing.
LEAST_PARTICIPANTS = 3
#: Figures that are tested: the field of `TrialResult`, its words, a unit, and its parts in one.
_MEASURES = (
    ("rms_error_m", "error, root mean square", "mm", 1000.0),
    ("seconds", "time of a movement", "s", 1.0),
    ("throughput_bit_s", "throughput", "bit/s", 1.0),
    ("path_m", "path", "mm", 1000.0),
    ("overshoot_m", "overshoot", "mm", 1000.0),
    ("force_mean_n", "mean force", "N", 1.0),
)
_Table = NDArray[np.float64]


@dataclass(frozen=True)
class Effect:
    """A test of one factor, or of two together, on one figure of one task.

    f, df, df_error, p: of the test, corrected for sphericity. partial_eta2: share of the variance.
    p_holm: corrected for all tests of the report. levels: the mean at each level of one factor, in
    `unit`; empty for two.
    """

    task: str
    measure: str
    unit: str
    factor: str
    f: float
    df: float
    df_error: float
    p: float
    partial_eta2: float
    p_holm: float = 1.0
    levels: dict[str, float] = field(default_factory=dict)

    @property
    def differs(self) -> bool:
        return self.p_holm < ALPHA


@dataclass(frozen=True)
class Cell:
    """A figure of a task with one handle. half_ci: half a 95 % interval within participants, whose
    differences from each other are taken out first."""

    task: str
    measure: str
    unit: str
    condition: str
    mean: float
    half_ci: float


@dataclass(frozen=True, kw_only=True)
class StudyReport:
    """participants: who have finished, whose trials count. missed, voids: targets that were not
    hit, trials that were begun again."""

    plan: str
    note: str
    participants: tuple[int, ...]
    unfinished: tuple[int, ...]
    missed: int
    voids: int
    cells: tuple[Cell, ...]
    effects: tuple[Effect, ...]


def study_report(plan: StudyPlan, results: Sequence[TrialResult]) -> StudyReport:
    """Analyse the results. Needs scipy."""
    known = [result.participant for result in results]
    through = [one for one in sorted({*known}) if known.count(one) >= plan.trials_each]
    rows = [result for result in results if result.counts and result.participant in through]
    cells: list[Cell] = []
    effects: list[Effect] = []
    for task in plan.tasks:
        own = [row for row in rows if row.task == task.name]
        for name, measure, unit, scale in _MEASURES:
            table = scale * _table(plan, own, name)
            if len(table) < LEAST_PARTICIPANTS:
                continue
            of = task.name, measure, unit
            cells += _cells(plan, table, of)
            effects += _effects(plan, table, of)
    return StudyReport(
        plan=plan.name,
        note=plan.note,
        participants=tuple(through),
        unfinished=tuple(sorted({*known} - {*through})),
        missed=sum(row.missed for row in rows),
        voids=sum(row.attempts - 1 for row in rows),
        cells=tuple(cells),
        effects=tuple(holm(effects)),
    )


def _table(plan: StudyPlan, rows: Sequence[TrialResult], name: str) -> _Table:
    """A row for each participant, a column for each condition; who lacks one is left out."""
    found = []
    for participant in sorted({row.participant for row in rows}):
        values: list[list[float]] = [[] for _ in plan.handle.conditions]
        for row in rows:
            if row.participant == participant and (value := getattr(row, name)) is not None:
                values[plan.handle.conditions.index(row.condition)].append(value)
        if all(values):
            found.append([float(np.mean(each)) for each in values])
    return np.array(found, float).reshape(-1, len(plan.handle.conditions))


def _cells(plan: StudyPlan, table: _Table, of: tuple[str, str, str]) -> Iterator[Cell]:
    from scipy.stats import t

    count, conditions = table.shape
    within = table - table.mean(1, keepdims=True)
    # R. D. Morey 2008: without the participants' differences the variance is too small by this.
    spread = within.std(0, ddof=1) * sqrt(conditions / (conditions - 1))
    halves = spread / sqrt(count) * t.ppf(1.0 - ALPHA / 2.0, count - 1)
    for one, mean, half in zip(plan.handle.conditions, table.mean(0), halves, strict=True):
        yield Cell(*of, one.words, float(mean), float(half))


def _effects(plan: StudyPlan, table: _Table, of: tuple[str, str, str]) -> Iterator[Effect]:
    """Those of each factor that has levels, and of each two of them."""
    levels = [getattr(plan.handle, name) for name in FACTORS]
    varied = [number for number, each in enumerate(levels) if len(each) > 1]
    cube = table.reshape(-1, *map(len, levels))
    for chosen in [*combinations(varied, 1), *combinations(varied, 2)]:
        contrasts = np.ones((1, 1))
        for number, each in enumerate(levels):
            count = len(each)
            equal = np.full((count, 1), count**-0.5)
            contrasts = np.kron(contrasts, helmert(count) if number in chosen else equal)
        tested = repeated_measures(table @ contrasts)
        if tested is None:
            continue
        means: dict[str, float] = {}
        if len(chosen) == 1:
            others = tuple(axis for axis in range(4) if axis != chosen[0] + 1)
            named = zip(levels[chosen[0]], cube.mean(others), strict=True)
            means = {f"{level:g}": float(mean) for level, mean in named}
        factor = " with ".join(FACTORS[number].partition("_")[0] for number in chosen)
        yield Effect(*of, factor, *tested, levels=means)


def helmert(count: int) -> _Table:
    """Orthonormal columns (count, count - 1), each of which sums up to 0."""
    columns = np.zeros((count, count - 1))
    for k in range(1, count):
        columns[:k, k - 1], columns[k, k - 1] = 1.0, -k
        columns[:, k - 1] /= sqrt(k * (k + 1))
    return columns


def repeated_measures(contrasts: _Table) -> tuple[float, float, float, float, float] | None:
    """F, its two degrees of freedom, p and partial eta squared of values (participants, contrasts).

    None where participants do not differ in them at all. Needs scipy.
    """
    from scipy.stats import f as distribution

    count, width = contrasts.shape
    mean = contrasts.mean(0)
    effect, error = count * float(mean @ mean), float(((contrasts - mean) ** 2).sum())
    if error < 1e-18 * max(1.0, effect):
        return None
    spread = np.atleast_2d(np.cov(contrasts, rowvar=False))
    epsilon = float(np.trace(spread)) ** 2 / (width * float((spread**2).sum()))
    df, df_error = epsilon * width, epsilon * width * (count - 1)
    f = effect / (error / (count - 1))
    return f, df, df_error, float(distribution.sf(f, df, df_error)), effect / (effect + error)


def holm(effects: Sequence[Effect]) -> list[Effect]:
    """The same with `p_holm`, so that the chance of one false difference among all is `ALPHA`."""
    found, most = list(effects), 0.0
    order = sorted(range(len(found)), key=lambda index: found[index].p)
    for rank, index in enumerate(order):
        most = max(most, min(1.0, found[index].p * (len(found) - rank)))
        found[index] = replace(found[index], p_holm=most)
    return found


HEADINGS = ("task", "figure", "factor", "mean at each level", "F", "p", "p, all tests", "η²", "")


def effect_words(effect: Effect) -> tuple[str, ...]:
    """A row below `HEADINGS`."""
    levels = ", ".join(f"{level}: {mean:.3g}" for level, mean in effect.levels.items())
    return (
        effect.task,
        f"{effect.measure}, {effect.unit}",
        effect.factor,
        levels,
        f"{effect.f:.2f} ({effect.df:.1f}, {effect.df_error:.1f})",
        f"{effect.p:.4f}",
        f"{effect.p_holm:.4f}",
        f"{effect.partial_eta2:.2f}",
        "differs" if effect.differs else "",
    )


def summary_of(report: StudyReport) -> Iterator[str]:
    """Who took part, in lines."""
    note = f", {report.note}" if report.note else ""
    yield f"{report.plan}{note}: {len(report.participants)} participants have finished"
    if report.unfinished:
        yield f"left out, because they are not through: {', '.join(map(str, report.unfinished))}"
    yield f"targets missed: {report.missed}; trials begun again: {report.voids}"
    if not report.effects:
        yield "no effects: at least 3 participants must be through, and their figures must vary"


def account_of_study(report: StudyReport) -> str:
    found = [effect for effect in report.effects if effect.differs]
    rows = map(effect_words, [*found, *(effect for effect in report.effects if not effect.differs)])
    parts = [
        f"<h1>{escape(report.plan)}</h1>",
        *(f"<p>{escape(line)}</p>" for line in summary_of(report)),
        *section(f"Effects; differs: p of all tests below {ALPHA:g}", table(HEADINGS, rows)),
    ]
    for (task, measure, unit), cells in groupby(
        report.cells, key=lambda one: (one.task, one.measure, one.unit)
    ):
        heading = escape(f"{task}: {measure}, {unit}, with 95 % within participants")
        parts += section(heading, _bars(list(cells)))
    return whole_page(report.plan, parts)


def _bars(cells: Sequence[Cell]) -> Iterator[str]:
    most = max(cell.mean + cell.half_ci for cell in cells) or 1.0
    for cell in cells:
        ends = cell.mean - cell.half_ci, cell.mean + cell.half_ci
        bars = [Bar(0.0, cell.mean, "run", "mean")]
        bars += [Bar(end, end, "mark", "95 % interval") for end in ends]
        words = f"{cell.mean:.3g} ± {cell.half_ci:.2g} {cell.unit}"
        yield track(cell.condition, bars, most, words)

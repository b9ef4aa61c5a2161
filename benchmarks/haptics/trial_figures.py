"""The figures of a trial, all from motions and forces outside the controllers, and what they say.

A core.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from math import nan
from statistics import median

import numpy as np

from benchmarks.haptics.figures import FADES, Values, series_n_m
from benchmarks.haptics.hands import TRIAL_HANDS
from benchmarks.haptics.trial import (
    BAND_NAMES,
    FELT_AFTER_S,
    FIRST,
    LAST,
    REST,
    START,
    Trial,
    TrialPlan,
)
from benchmarks.haptics.trial_run import Course

#: Felt stiffness is a mean over so long (ms).
_MEAN_MS = 250
#: A smaller penetration (m) counts as this one.
_LEAST_M = 1e-4
#: Slower than this (m/s) a hand feels no drag.
_MOVES_M_S = 0.05


@dataclass(frozen=True, kw_only=True, slots=True)
class TrialFigures:
    """None: not in this trial.

    felt_first, felt_last, felt_restart: stiffness along the wall's normal over the ideal (%), at
    the end of the first press of 1.5 s and three round trips, of the last one, and 1 s after a
    restart in contact. network_uj: the most that both ends together had given out. robot_uj: the
    most that the robot had got beyond what the motors had taken from the hand. motors_mj: the most
    that the motors had given the hand beyond what they had taken. swing_n: peak to peak of the
    forces in the last third of the last press and of the rest, where it does not fade. step_n_ms:
    largest change of the force on the hand, without those of a joystick that starts. drift_mm:
    distance of handle and tip after 3 s of rest. drag_early, drag_late: force against free motion
    over its speed (N s/m), in the first 3 s of motion and after 6 s. touches: three are planned.
    """

    trial: Trial
    felt_first: float
    felt_last: float
    felt_restart: float | None
    network_uj: float
    robot_uj: float
    motors_mj: float
    swing_n: float | None
    step_n_ms: float
    drift_mm: float
    drag_early: float | None
    drag_late: float | None
    touches: int


#: Name, unit and whether the smallest is the worst.
FIGURES: Mapping[str, tuple[str, str, bool]] = {
    "felt_first": ("felt, first press", "%", True),
    "felt_last": ("felt, last press", "%", True),
    "felt_restart": ("felt 1 s after restart", "%", True),
    "network_uj": ("network gave", "µJ", False),
    "robot_uj": ("robot beyond hand", "µJ", False),
    "motors_mj": ("motors gave", "mJ", False),
    "swing_n": ("swing", "N", False),
    "step_n_ms": ("step", "N/ms", False),
    "drift_mm": ("drift", "mm", False),
    "drag_early": ("drag, early", "N s/m", False),
    "drag_late": ("drag, late", "N s/m", False),
    "touches": ("touches", "", False),
}


def trial_figures(trial: Trial, planned: TrialPlan, course: Course) -> TrialFigures:
    """The figures of one run."""
    phases = np.array(planned.phases)[course["waypoint"].astype(int)]
    handle, motor = _vectors(course, "handle"), _vectors(course, "motor")
    wall, tip = _vectors(course, "wall"), _vectors(course, "tip")
    contact = np.hypot(*wall.T) > 0.0
    lives = np.diff(course["joystick_lives"], prepend=1.0) > 0.0
    starts = np.flatnonzero(lives | (np.diff(course["robot_lives"], prepend=1.0) > 0.0))
    restart = int(starts[0]) if len(starts) and trial.at == "contact" else None
    shares = _felt(trial, course, handle, motor)

    def felt_until(end: int) -> float:
        return float(np.mean(shares[max(0, end - _MEAN_MS) : end]))

    first, last, rest = (_span(phases, phase) for phase in (FIRST, LAST, REST))
    gains_j = -np.diff(course["motor_work"], prepend=0.0)
    taken_j = np.cumsum(np.maximum(gains_j, 0.0))
    steps = np.hypot(*np.diff(motor, axis=0).T)
    steps[lives[1:]] = 0.0
    calm = not trial.bench_hand.tremor_n
    forces = np.hstack((motor, wall))
    apart = handle + _vectors(course, "offset") - tip
    settled = rest[0] + round(1000 * trial.bench_hand.back_s) + 3000
    onsets = np.flatnonzero(contact[1:] & ~contact[:-1])
    early, late = _drags(trial, handle, motor, contact, _span(phases, START)[1])
    return TrialFigures(
        trial=trial,
        felt_first=felt_until(first[1]),
        felt_last=felt_until(last[1]),
        felt_restart=None
        if restart is None
        else felt_until(restart + round(1000 * FELT_AFTER_S) + _MEAN_MS // 2),
        network_uj=1e6 * float((course["motor_work"] + course["drive_work"]).max()),
        robot_uj=1e6 * float((course["drive_work"] - taken_j).max()),
        motors_mj=1e3 * float(course["motor_work"].max()),
        swing_n=max(_swing(forces, last), _swing(forces, rest)) if calm else None,
        step_n_ms=float(steps.max()),
        drift_mm=1e3 * float(np.hypot(*apart[settled - 100 : settled].T).max()),
        drag_early=early,
        drag_late=late,
        touches=len(onsets),
    )


def _vectors(course: Course, name: str) -> Values:
    return np.stack((course[f"{name}_x"], course[f"{name}_y"]), axis=1)


def _span(phases: Values, phase: str) -> tuple[int, int]:
    """First row of the phase, and the one after its last."""
    rows = np.flatnonzero(phases == phase)
    return int(rows[0]), int(rows[-1]) + 1


def _felt(trial: Trial, course: Course, handle: Values, motor: Values) -> Values:
    """Felt stiffness over the ideal (%) in each millisecond."""
    normal = np.array(trial.normal)
    depth_m = (handle + _vectors(course, "offset")) @ normal - trial.place / 1000.0
    ideal_n_m = series_n_m(trial.wall)
    felt: Values = -100.0 * (motor @ normal) / np.maximum(depth_m, _LEAST_M) / ideal_n_m
    return felt


def _swing(forces: Values, span: tuple[int, int]) -> float:
    """Peak to peak (N) in the last third of `span`; 0 if it fades."""
    begin, end = span
    third = (end - begin) // 3
    middle, last = (
        float(np.ptp(forces[part], axis=0).max())
        for part in (slice(end - 2 * third, end - third), slice(end - third, end))
    )
    return last if last > FADES * middle else 0.0


def _drags(
    trial: Trial, handle: Values, motor: Values, contact: Values, begin: int
) -> tuple[float | None, float | None]:
    """Drag in the first 3 s from `begin` on, and after 6 s, far from any contact."""
    velocity = np.diff(handle, axis=0) * 1000.0
    after = round(trial.delay + trial.jitter) + 300
    onto = np.convolve(contact, np.ones(after))[: len(contact)] > 0.0
    free = ~onto[1:] & (np.hypot(*velocity.T) > _MOVES_M_S)
    at = np.arange(len(velocity)) - begin
    # The force of a row acts until the next one.
    power, speed = (motor[:-1] * velocity).sum(axis=1), (velocity**2).sum(axis=1)
    early, late = (
        float(-power[part].sum() / speed[part].sum()) if part.any() else None
        for part in (free & (at >= 0) & (at < 3000), free & (at > 6000))
    )
    return early, late


@dataclass(frozen=True, kw_only=True, slots=True)
class Summary:
    """One figure over the trials of a group. worst_trial: the text of the worst."""

    mode: str
    grouping: str
    group: str
    figure: str
    trials: int
    median: float
    worst: float
    worst_trial: str


#: What puts trials into groups, and the groups in their order.
_GROUPINGS: Mapping[str, tuple[Callable[[Trial], str], Sequence[str]]] = {
    "all": (lambda trial: "all", ("all",)),
    "band": (lambda trial: trial.band, BAND_NAMES),
    "hand": (lambda trial: trial.hand, tuple(TRIAL_HANDS)),
}


def summaries(found: Sequence[TrialFigures]) -> Iterator[Summary]:
    """Each figure by mode: over all trials, by band of the round trip, and by hand."""
    for mode in dict.fromkeys(figures.trial.mode for figures in found):
        for grouping, (name_of, names) in _GROUPINGS.items():
            for name in names:
                group = [f for f in found if (f.trial.mode, name_of(f.trial)) == (mode, name)]
                for figure in FIGURES if group else ():
                    yield _summary(mode, grouping, name, figure, group)


def _summary(
    mode: str, grouping: str, name: str, figure: str, group: Sequence[TrialFigures]
) -> Summary:
    pairs = [(getattr(each, figure), each.trial.name) for each in group]
    values = [(value, text) for value, text in pairs if value is not None]
    worst, text = (min if FIGURES[figure][2] else max)(values, default=(nan, ""))
    return Summary(
        mode=mode,
        grouping=grouping,
        group=name,
        figure=figure,
        trials=len(values),
        median=median(value for value, _ in values) if values else nan,
        worst=worst,
        worst_trial=text,
    )

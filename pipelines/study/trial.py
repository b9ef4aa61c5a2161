"""One trial: where its target is, when it is hit, and how well the hand did. A core."""

from dataclasses import asdict, dataclass
from math import cos, hypot, log2, pi, sin, sqrt
from random import Random
from statistics import fmean, stdev
from typing import NamedTuple

from kontur_av.clock import NS_PER_MS, NS_PER_S
from pipelines.study.plan import FACTORS, SWING_M, Aiming, HandleCondition, PlannedTrial, Tracking

#: Errors of tracking count after this time, when the hand has caught up.
LEAD_NS = NS_PER_S
#: Effective width over the standard deviation of endpoints (ISO 9241-411, annex B).
_EFFECTIVE = 4.133
#: The oscillations of a wandering circle, as shares of the fastest, and their sizes. Chosen.
_WAVES = ((0.31, 0.5), (0.57, 0.3), (1.0, 0.2))

Spot = tuple[float, float]


@dataclass(frozen=True, kw_only=True)
class TrialResult:
    """How a trial went; a row of the study's results.

    trial: its number in the participant's order, from 1. place: of the handle in that order, from
    1. counts: it is no practice. attempts: how often it was begun. missed: targets that were not
    hit. seconds: of a movement, to where the dot came to stay in the target, on average.
    overshoot_m: beyond the target's far edge, on average.
    rms_error_m: of the dot to the target's middle, at the end of each movement or all the time.
    throughput_bit_s: ISO 9241-411, with the effective width. force_mean_n, force_max_n: of the
    handle on the hand, with its inertia. None: the task has no such figure.
    """

    participant: int
    trial: int
    place: int
    stiffness_n_m: float
    damping_n_s_m: float
    inertia_kg: float
    task: str
    counts: bool
    repetition: int
    attempts: int
    missed: int
    difficulty_bits: float | None
    seconds: float | None
    path_m: float
    overshoot_m: float | None
    rms_error_m: float | None
    throughput_bit_s: float | None
    force_mean_n: float
    force_max_n: float
    note: str

    @property
    def condition(self) -> HandleCondition:
        return HandleCondition(**{name: getattr(self, name) for name in FACTORS})


class _Hit(NamedTuple):
    """A movement: its time, its way, the miss along that way, the miss, and the overshoot."""

    seconds: float
    way_m: float
    along_m: float
    miss_m: float
    beyond_m: float


class StudyTrial:
    """Call `step` for each millisecond. start_m: where the handle is to be before it begins.

    target_m: what is to be reached now. finished: all is done.
    """

    def __init__(self, planned: PlannedTrial) -> None:
        self.planned, self.task = planned, planned.task
        self.finished = False
        self._ns = self._since_ns = self._in_ns = 0
        self._last: Spot | None = None
        self._begin: Spot = (0.0, 0.0)
        self._path_m = self._force_sum_n = self._force_max_n = self._square_m2 = 0.0
        self._missed = self._number = 0
        self._beyond_m = 0.0
        self._hits: list[_Hit] = []
        self._chance = Random(planned.seed)
        self._way = 1
        #: Of each axis, the waves of a wandering circle: size (m), rate (1/s), phase.
        self._waves: list[list[tuple[float, float, float]]] = []
        if isinstance(self.task, Tracking):
            reach_m, fastest = self.task.reach_m / sqrt(2.0), 2.0 * pi * self.task.fastest_hz
            self._waves = [
                [
                    (reach_m * size, share * fastest, self._chance.uniform(0.0, 2.0 * pi))
                    for share, size in _WAVES
                ]
                for _ in range(2)
            ]
        self.start_m = self.target_m = self._target()
        self._number = 1

    @property
    def moves(self) -> bool:
        return not isinstance(self.task, Aiming) or self.task.speed_m_s > 0.0

    def step(self, x_m: float, y_m: float, force_n: float) -> None:
        """A millisecond has passed with the handle at (x_m, y_m), which pushes the hand so hard."""
        self._ns += NS_PER_MS
        if self._last is None:
            self._begin = x_m, y_m
        else:
            self._path_m += hypot(x_m - self._last[0], y_m - self._last[1])
        self._last = x_m, y_m
        self._force_sum_n += force_n
        self._force_max_n = max(self._force_max_n, force_n)
        self.target_m = self._target()
        if isinstance(self.task, Aiming):
            self._aim(self.task, x_m, y_m)
            return
        if self._ns > LEAD_NS:
            self._square_m2 += (x_m - self.target_m[0]) ** 2 + (y_m - self.target_m[1]) ** 2
        self.finished = self._ns >= self.task.seconds * NS_PER_S + LEAD_NS

    def _target(self) -> Spot:
        task = self.task
        if isinstance(task, Tracking):
            now_s = self._ns / NS_PER_S
            x, y = (
                sum(size * sin(rate * now_s + phase) for size, rate, phase in waves)
                for waves in self._waves
            )
            return x, y
        # Half around and one on, so that each place of an odd number comes once.
        angle = 2.0 * pi * (self._number * (task.targets // 2 + 1) % task.targets) / task.targets
        radius, aside = task.distance_m / 2.0, 0.0
        if self._number and task.speed_m_s:
            gone = task.speed_m_s * (self._ns - self._since_ns) / NS_PER_S % (4.0 * SWING_M)
            # To the end of its swing, back to the other end, and so on.
            aside = gone if gone < SWING_M else abs(gone - 3.0 * SWING_M) - SWING_M
            aside *= self._way
        return radius * sin(angle) + aside * cos(angle), radius * cos(angle) - aside * sin(angle)

    def _aim(self, task: Aiming, x_m: float, y_m: float) -> None:
        target, begin = self.target_m, self._begin
        miss_x, miss_y = x_m - target[0], y_m - target[1]
        way_x, way_y = target[0] - begin[0], target[1] - begin[1]
        way_m, miss_m = hypot(way_x, way_y) or 1e-9, hypot(miss_x, miss_y)
        along_m = (miss_x * way_x + miss_y * way_y) / way_m
        self._beyond_m = max(self._beyond_m, along_m - task.width_m / 2.0)
        self._in_ns = self._in_ns + NS_PER_MS if miss_m <= task.width_m / 2.0 else 0
        took_ns = self._ns - self._since_ns
        if self._in_ns >= task.hold_s * NS_PER_S:
            seconds = (took_ns - self._in_ns) / NS_PER_S
            self._hits.append(_Hit(seconds, way_m, along_m, miss_m, self._beyond_m))
        elif took_ns >= task.patience_s * NS_PER_S:
            self._missed += 1
        else:
            return
        self.finished = self._number == task.targets
        self._number += 1
        self._since_ns, self._in_ns, self._beyond_m = self._ns, 0, 0.0
        self._begin = x_m, y_m
        self._way = self._chance.choice((-1, 1))

    def result(self, *, number: int, attempts: int, note: str) -> TrialResult:
        """The row of a finished trial. number: in the participant's order, from 1."""
        planned, hits = self.planned, self._hits
        steps = max(1, self._ns // NS_PER_MS)
        if isinstance(self.task, Tracking):
            counted = max(1, steps - LEAD_NS // NS_PER_MS)
            rms_m: float | None = sqrt(self._square_m2 / counted)
        else:
            rms_m = sqrt(fmean(hit.miss_m**2 for hit in hits)) if hits else None
        return TrialResult(
            **asdict(planned.condition),
            participant=planned.participant,
            trial=number,
            place=planned.place,
            task=planned.task.name,
            counts=planned.counts,
            repetition=planned.repetition,
            attempts=attempts,
            missed=self._missed,
            difficulty_bits=planned.task.difficulty_bits,
            seconds=fmean(hit.seconds for hit in hits) if hits else None,
            path_m=self._path_m,
            overshoot_m=fmean(hit.beyond_m for hit in hits) if hits else None,
            rms_error_m=rms_m,
            throughput_bit_s=self._throughput(),
            force_mean_n=self._force_sum_n / steps,
            force_max_n=self._force_max_n,
            note=note,
        )

    def _throughput(self) -> float | None:
        """Effective index of difficulty over time: ISO 9241-411, annex B."""
        hits = self._hits
        if len(hits) < 3 or not (spread_m := stdev(hit.along_m for hit in hits)):
            return None
        distance_m = fmean(hit.way_m + hit.along_m for hit in hits)
        seconds = fmean(hit.seconds for hit in hits)
        return log2(distance_m / (_EFFECTIVE * spread_m) + 1.0) / seconds if seconds else None

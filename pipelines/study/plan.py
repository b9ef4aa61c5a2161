"""The plan of a study: handles, tasks, and the order in which each meets them; its trials. A core.

Every participant meets every handle. The order is a balanced Latin square (E. J. Williams,
"Experimental designs balanced for the estimation of residual effects of treatments", Aust. J. Sci.
Res. A2, 1949): each handle stands equally often at each place, and follows each other one equally
often.
"""

from dataclasses import asdict, dataclass
from itertools import product
from math import cos, hypot, log2, pi, sin, sqrt
from random import Random
from statistics import fmean, stdev
from typing import NamedTuple

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.errors import ConfigError
from telepresence.haptics.device.page import CAPABILITIES, GRIP

#: What a page's hand pulls at the farthest target; the rest of `GRIP.push_n` moves the handle.
_PULL_N = 0.75 * GRIP.push_n
#: Targets stay so far from the handle's stops.
_MARGIN_M = 0.005
#: A moving target goes so far to either side.
SWING_M = 0.02


def _check(at: str, fields: object, **ranges: tuple[float, float]) -> None:
    for name, (least, most) in ranges.items():
        value = getattr(fields, name)
        for one in value if isinstance(value, tuple) else (value,):
            if not least <= one <= most:
                raise ConfigError(f"{at}{name} is {one:g}: give {least:g} to {most:g}")


@dataclass(frozen=True, kw_only=True)
class HandleCondition:
    """A handle. stiffness_n_m, damping_n_s_m: towards its middle. inertia_kg: in addition."""

    stiffness_n_m: float = 0.0
    damping_n_s_m: float = 0.0
    inertia_kg: float = 0.0

    @property
    def words(self) -> str:
        return f"{self.stiffness_n_m:g} N/m, {self.damping_n_s_m:g} N s/m, {self.inertia_kg:g} kg"


#: The factors of a study, in the order in which the levels of `HandleLevels` are combined.
FACTORS = ("stiffness_n_m", "damping_n_s_m", "inertia_kg")


@dataclass(frozen=True, kw_only=True)
class HandleLevels:
    """The levels of each factor; every combination is a condition. ConfigError."""

    stiffness_n_m: tuple[float, ...] = (0.0,)
    damping_n_s_m: tuple[float, ...] = (0.0,)
    inertia_kg: tuple[float, ...] = (0.0,)

    def __post_init__(self) -> None:
        # Chosen: with 60 N s/m, the 8 N of a page's hand still move the handle at 0.13 m/s.
        most = {"stiffness_n_m": (0, 400), "damping_n_s_m": (0, 60), "inertia_kg": (0, 5)}
        _check("handle.", self, **most)
        for name in FACTORS:
            levels = getattr(self, name)
            if not levels or len({*levels}) < len(levels):
                raise ConfigError(f"handle.{name} is {[*levels]}: give different levels")
        if not 2 <= (count := len(self.conditions)) <= 16:
            raise ConfigError(
                f"handle has {count} combinations of levels: give 2 to 16, as by "
                "damping_n_s_m = [0, 10]"
            )

    @property
    def conditions(self) -> list[HandleCondition]:
        """Every combination; the last factor varies fastest."""
        levels = product(*(getattr(self, name) for name in FACTORS))
        return [HandleCondition(**dict(zip(FACTORS, chosen, strict=True))) for chosen in levels]


@dataclass(frozen=True, kw_only=True)
class Aiming:
    """Targets on a ring, each across from the one before (ISO 9241-411, annex B). ConfigError.

    distance_m: diameter of the ring. width_m: of a target. targets: how many, an odd number.
    hold_s: how long the dot must stay in a target to hit it. patience_s: after that it is missed.
    speed_m_s: of targets that move to and fro along the ring; 0 for still ones.
    """

    name: str
    distance_m: float = 0.1
    width_m: float = 0.012
    targets: int = 9
    hold_s: float = 0.3
    patience_s: float = 8.0
    speed_m_s: float = 0.0

    def __post_init__(self) -> None:
        at = f"aiming {self.name}: "
        _check(at, self, width_m=(0.002, 0.05), targets=(5, 25), hold_s=(0.1, 2))
        _check(at, self, distance_m=(2 * self.width_m, 0.2), patience_s=(2, 60), speed_m_s=(0, 0.1))
        if self.targets % 2 == 0:
            raise ConfigError(f"{at}targets is {self.targets}: give an odd number")

    @property
    def reach_m(self) -> float:
        """The farthest place of a target from the middle."""
        return hypot(self.distance_m / 2, SWING_M if self.speed_m_s else 0.0)

    @property
    def difficulty_bits(self) -> float | None:
        """Fitts' index of difficulty (I. S. MacKenzie 1992): log2(distance / width + 1)."""
        return log2(self.distance_m / self.width_m + 1.0)

    @property
    def words(self) -> str:
        moving = ", which moves" if self.speed_m_s else ""
        return (
            f"A circle lights up{moving}. Bring the dot into it and keep it there until the next "
            "circle lights up. Be quick, and miss none."
        )


@dataclass(frozen=True, kw_only=True)
class Tracking:
    """A circle that wanders smoothly over the field. ConfigError.

    seconds: how long. width_m: of the circle. reach_m: the farthest it goes from the middle.
    fastest_hz: the fastest of its oscillations.
    """

    name: str
    seconds: float = 15.0
    width_m: float = 0.012
    reach_m: float = 0.06
    fastest_hz: float = 0.35

    def __post_init__(self) -> None:
        at = f"tracking {self.name}: "
        _check(at, self, seconds=(2, 120), width_m=(0.002, 0.05), fastest_hz=(0.05, 2))
        _check(at, self, reach_m=(0.02, CAPABILITIES.half_height_m))

    @property
    def difficulty_bits(self) -> float | None:
        """Fitts' law says nothing of it."""
        return None

    @property
    def words(self) -> str:
        return f"A circle wanders over the field. Keep the dot in it, for {self.seconds:g} seconds."


@dataclass(frozen=True, kw_only=True)
class StudyPlan:
    """A study; docs/simulation.md has an annotated file. ConfigError for what cannot work.

    consent: what a participant agrees to. note: kept with every trial, such as "with loss of weight
    of the arm". participants: a multiple of the orders that the Latin square has.
    seed: of the orders and of the targets' ways. practice, trials: of each task with each handle.
    break_s: the least rest after `break_every` handles.
    """

    name: str
    consent: str
    participants: int
    handle: HandleLevels
    aiming: tuple[Aiming, ...] = ()
    tracking: tuple[Tracking, ...] = ()
    note: str = ""
    seed: int = 0
    practice: int = 1
    trials: int = 3
    break_s: float = 30.0
    break_every: int = 2

    def __post_init__(self) -> None:
        if not self.consent.strip():
            raise ConfigError('consent is "": write what a participant agrees to')
        names = [task.name for task in self.tasks]
        if not names or "" in names or len({*names}) < len(names):
            raise ConfigError(
                f"the tasks are {names}: write [[aiming]] or [[tracking]], each named"
            )
        _check("", self, practice=(0, 50), trials=(1, 50), break_s=(0, 3600), break_every=(1, 16))
        _check("", self, seed=(0, 1 << 53), participants=(1, 1000))
        handles = len(self.handle.conditions)
        if self.participants % (orders := len(latin_square(handles))):
            raise ConfigError(
                f"participants is {self.participants}: {handles} handles have {orders} orders, so "
                f"take {orders}, {2 * orders}, {3 * orders} and so on"
            )
        most_m, stiffest = CAPABILITIES.half_height_m - _MARGIN_M, max(self.handle.stiffness_n_m)
        for task in self.tasks:
            if (far_m := task.reach_m + task.width_m / 2) > most_m:
                raise ConfigError(
                    f"{task.name}: targets are up to {far_m:.3f} m from the middle: keep them "
                    f"within {most_m:g} m"
                )
            if (pull_n := stiffest * task.reach_m) > _PULL_N:
                raise ConfigError(
                    f"handle.stiffness_n_m is {stiffest:g}: {task.name} needs {pull_n:.1f} N, and "
                    f"a hand at the page pulls {_PULL_N:g}: take {int(_PULL_N / task.reach_m)}"
                )

    @property
    def tasks(self) -> tuple[Aiming | Tracking, ...]:
        return *self.aiming, *self.tracking

    @property
    def trials_each(self) -> int:
        """How many trials a participant has."""
        return len(self.handle.conditions) * len(self.tasks) * (self.practice + self.trials)


def latin_square(count: int) -> list[list[int]]:
    """The orders of `count` conditions: as many rows for an even number, else twice as many."""
    # 0, 1, n - 1, 2, n - 2: each difference of neighbours comes once.
    first = [(step + 1) // 2 if step % 2 else -step // 2 for step in range(count)]
    rows = [[(index + shift) % count for index in first] for shift in range(count)]
    return rows if count % 2 == 0 else rows + [row[::-1] for row in rows]


@dataclass(frozen=True, kw_only=True)
class PlannedTrial:
    """A trial. place: of the handle in the participant's order, from 1. counts: it is no practice.

    opens: the first trial of its task with this handle. repetition: from 1, among those that count,
    or among those that do not. seed: of the target's way.
    """

    participant: int
    place: int
    condition: HandleCondition
    task: Aiming | Tracking
    counts: bool
    opens: bool
    repetition: int
    seed: int


def trials_of(plan: StudyPlan, participant: int) -> list[PlannedTrial]:
    conditions, square = plan.handle.conditions, latin_square(len(plan.handle.conditions))
    # Random: each participant's row, and the handle behind each number.
    chance = Random(plan.seed)
    chance.shuffle(square)
    chance.shuffle(conditions)
    found: list[PlannedTrial] = []
    for place, index in enumerate(square[(participant - 1) % len(square)], 1):
        first = (participant + place) % len(plan.tasks)
        for task in (*plan.tasks[first:], *plan.tasks[:first]):
            for number in range(plan.practice + plan.trials):
                counts = number >= plan.practice
                found.append(
                    PlannedTrial(
                        participant=participant,
                        place=place,
                        condition=conditions[index],
                        task=task,
                        counts=counts,
                        opens=number == 0,
                        repetition=number + 1 - (plan.practice if counts else 0),
                        # Ways differ by trial, and are the same for every handle.
                        seed=(plan.seed * 101 + number) * 101 + plan.tasks.index(task),
                    )
                )
    return found


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

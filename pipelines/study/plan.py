"""The plan of a study: handles, tasks, and the order in which each participant meets them. A core.

Every participant meets every handle. The order is a balanced Latin square (E. J. Williams,
"Experimental designs balanced for the estimation of residual effects of treatments", Aust. J. Sci.
Res. A2, 1949): each handle stands equally often at each place, and follows each other one equally
often.
"""

from dataclasses import dataclass
from itertools import product
from math import hypot, log2
from random import Random

from kontur_av.errors import ConfigError
from telepresence.haptics.device.page import FACTS, GRIP

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
        _check(at, self, reach_m=(0.02, FACTS.half_height_m))

    @property
    def difficulty_bits(self) -> float | None:
        """Fitts' law says nothing of it."""
        return None

    @property
    def words(self) -> str:
        return f"A circle wanders over the field. Keep the dot in it, for {self.seconds:g} seconds."


@dataclass(frozen=True, kw_only=True)
class StudyPlan:
    """A study; docs/study.md has an annotated file. ConfigError for what cannot work.

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
        most_m, stiffest = FACTS.half_height_m - _MARGIN_M, max(self.handle.stiffness_n_m)
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

"""A trial of `benchmarks haptics`: a cell with any wall, a restart and a mode; and its schedule.

The hand presses the wall for the first time, goes back, moves freely, presses for the second time,
which a blackout, a restart or the hand itself may disturb, moves freely, and presses for the last
time, for long. Then it rests in the middle. A core.
"""

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, fields, replace
from math import cos, radians, sin
from random import Random
from typing import ClassVar

from benchmarks.haptics.cell import Cell
from benchmarks.haptics.hands import TRIAL_HANDS, BenchHand
from kontur_av.clock import NS_PER_MS
from telepresence.haptics.hand import Waypoint

#: A hand mode is a keyword of both sides, besides `direct` and `deadband`.
MODES = ("direct", "deadband", "mediated")
#: Round trips (ms) by which trials are drawn and grouped.
BANDS = ((0, 60), (60, 150), (150, 300), (300, 500), (500, 800))
BAND_NAMES = (*(f"{low}-{high} ms" for low, high in BANDS), "over 800 ms")
#: The phases of a trial.
START, FIRST, FREE, SECOND, LAST, REST = "start", "first", "free", "second", "last", "rest"
#: After a restart in contact, the felt stiffness is taken so much later (s).
FELT_AFTER_S = 1.0
_ENDS = ("none", "joystick", "robot", "both")


@dataclass(frozen=True, kw_only=True, slots=True)
class Trial(Cell):
    """A `Cell` on virtual time with one wall anywhere.

    angle: of the direction in which the tip meets the wall (degrees; 0: along x). place: distance
    of the wall from the middle (mm). free: free motion before the first press (s). restart: the end
    that begins a new life. at: `contact`, in the second press; or `free`, before it. mode: of the
    hand. envelope: the safety envelope is in the loop, and asks for presses.
    """

    wall: float = 1500.0
    angle: float = 0.0
    place: float = 60.0
    free: float = 0.0
    restart: str = "none"
    at: str = "contact"
    mode: str = "direct"
    envelope: str = "off"

    words: ClassVar[Mapping[str, Collection[str]]] = {
        "hand": TRIAL_HANDS,
        "restart": _ENDS,
        "at": ("contact", "free"),
        "mode": MODES,
        "envelope": ("off", "on"),
    }

    @property
    def name(self) -> str:
        """The text that `--trial` takes: what differs from the defaults."""
        values = ((field, getattr(self, field.name)) for field in fields(self))
        given = [(field.name, value) for field, value in values if value != field.default]
        texts = (f"{name}={v if isinstance(v, str) else f'{v:g}'}" for name, v in given)
        return ",".join(texts) or "delay=0"

    @property
    def setting(self) -> str:
        """The name without the mode: channels and hands of two modes are alike."""
        return replace(self, mode="direct").name

    @property
    def band(self) -> str:
        """The band of its round trip, for tables."""
        return BAND_NAMES[sum(self.delay > high for _, high in BANDS)]

    @property
    def normal(self) -> tuple[float, float]:
        """The direction in which the tip meets the wall."""
        return cos(radians(self.angle)), sin(radians(self.angle))

    @property
    def joystick_lives(self) -> int:
        return 2 if self.restart in ("joystick", "both") else 1

    @property
    def bench_hand(self) -> BenchHand:
        return TRIAL_HANDS[self.hand]


def random_trials(
    number: int, *, seed: int, modes: Sequence[str], envelope: str = "off"
) -> Iterator[Trial]:
    """`number` settings, each in all modes, drawn from `seed` alone."""
    for each in range(number):
        random = Random(f"{seed} {each}")
        low, high = BANDS[each % len(BANDS)]
        lost = round(random.choice((0.0, random.uniform(0.0, 20.0))))
        burst = random.choice((1, 1, random.randint(2, 20)))
        trial = Trial(
            delay=round(random.uniform(low, high)),
            jitter=round(random.choice((0.0, random.uniform(0.0, 50.0)))),
            loss=lost,
            burst=burst if lost else 1,
            blackout=random.choice((0.0, 0.0, 0.0, round(random.uniform(0.2, 3.0), 1))),
            wall=float(f"{50.0 * 40.0 ** random.random():.2g}"),
            angle=random.choice((-90, 0, 90, 180, *(random.randint(-179, 180) for _ in range(8)))),
            place=random.randint(15, 65),
            hand=random.choice(tuple(TRIAL_HANDS)),
            free=random.choice((0.0, 3.0)),
            restart=random.choice(("none", *_ENDS)),
            at=random.choice(("contact", "free")),
            envelope=envelope,
        )
        for mode in modes:
            yield replace(trial, mode=mode)


@dataclass(frozen=True, slots=True)
class TrialPlan:
    """script: of the hand. phases: the name of each waypoint.

    restart, leaves: number of a waypoint and time into it (ns). down_dark, up_dark: as in
    `CellPlan`. end_ns: of the script without a wait.
    """

    script: tuple[Waypoint, ...]
    phases: tuple[str, ...]
    restart: tuple[int, int]
    leaves: tuple[int, int]
    down_dark: tuple[tuple[int, int], ...]
    up_dark: tuple[tuple[int, int], ...]
    end_ns: int


def plan_trial(trial: Trial, seed: int) -> TrialPlan:
    """The schedule of `trial`; `seed` says which way a blackout cuts."""
    hand, (nx, ny) = trial.bench_hand, trial.normal
    round_trip_s = (trial.delay + trial.jitter) / 1000.0
    depth_m = trial.place / 1000.0 + hand.depth_m
    script: list[Waypoint] = []
    phases: list[str] = []

    def go(phase: str, ahead_m: float, across_m: float, move_s: float, stay_s: float) -> int:
        """Plan a waypoint; return when it is reached (ns)."""
        x, y = ahead_m * nx - across_m * ny, ahead_m * ny + across_m * nx
        script.append(Waypoint(x, y, _ns(move_s), _ns(stay_s)))
        phases.append(phase)
        return sum(point.move_ns + point.stay_ns for point in script) - _ns(stay_s)

    def move_freely(seconds: float) -> None:
        for number in range(round(seconds)):
            go(FREE, -0.03, 0.04 if number % 2 else -0.04, 1.0, 0.0)

    # The session begins after one and a half round trips, unless samples are lost.
    go(START, 0.0, 0.0, 0.0, 0.5 + 3.0 * round_trip_s)
    move_freely(trial.free)
    go(FIRST, depth_m, 0.0, 0.7, 1.5 + 3.0 * round_trip_s)
    go(FREE, 0.0, 0.0, hand.back_s, 0.0)
    move_freely(1.0)
    free = len(script)
    move_freely(1.0)
    disturbed_s = 1.0 + trial.blackout
    stay_s = disturbed_s + FELT_AFTER_S + 1.5 + 2.0 * round_trip_s
    dark_ns = go(SECOND, depth_m, 0.0, 0.7, stay_s) + _ns(0.3)
    second = len(script) - 1
    go(FREE, 0.0, 0.0, hand.back_s, 0.0)
    move_freely(3.0)
    go(LAST, depth_m, 0.0, 0.7, max(3.0, 12.0 * round_trip_s))
    go(REST, 0.0, 0.0, hand.back_s, 3.0 + 2.0 * round_trip_s)
    dark = ((dark_ns, dark_ns + _ns(trial.blackout)),) if trial.blackout else ()
    ways = Random(f"{seed} {trial.setting} dark").choice((1, 2, 3))
    in_contact = second, _ns(0.7 + disturbed_s)
    return TrialPlan(
        script=tuple(script),
        phases=tuple(phases),
        restart=in_contact if trial.at == "contact" else (free, _ns(0.5)),
        leaves=(second, _ns(0.7 + disturbed_s + FELT_AFTER_S + 0.3)),
        down_dark=dark if ways & 1 else (),
        up_dark=dark if ways & 2 else (),
        end_ns=sum(point.move_ns + point.stay_ns for point in script),
    )


def _ns(seconds: float) -> int:
    """In whole cycles of 1 ms."""
    return round(seconds * 1000) * NS_PER_MS

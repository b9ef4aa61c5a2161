"""The schedule of a run of a cell: the motion of the hand, blackouts and a restart. A core.

The hand presses the wall for the first time, goes back and moves freely. In a second press it waits
for three blackouts in turn, a restart, and what the hand itself may do. Then it moves freely and
presses for the last time, for long, until a stable loop has come to rest. It rests in the middle.
"""

from dataclasses import dataclass

from benchmarks.haptics.cell import Cell
from kontur_av.clock import NS_PER_MS
from telepresence.haptics.hand import Waypoint

#: The phases of a run.
START, FIRST, FREE, SECOND, LAST, REST = "start", "first", "free", "second", "last", "rest"
#: After a restart in contact, the felt stiffness is taken so much later (s).
FELT_AFTER_S = 1.0
#: An oscillation of the delayed loop has a period of 2 to 4 round trips; the hold has three thirds.
_HOLD_S, _HOLD_ROUND_TRIPS, _RECOVERY_S = 5.0, 12.0, 2.0


@dataclass(frozen=True, slots=True)
class CellPlan:
    """script: waypoints of the hand. phases: the name of each.

    down_dark, up_dark: blackouts of commands and of feedback, (begin, end) in ns. restart, leaves:
    number of a waypoint, and time into it (ns). hold_ns: of the last press, at its end, in which a
    stable loop is at rest. end_ns: of the script, if the hand never waits.
    """

    script: tuple[Waypoint, ...]
    phases: tuple[str, ...]
    down_dark: tuple[tuple[int, int], ...]
    up_dark: tuple[tuple[int, int], ...]
    restart: tuple[int, int]
    leaves: tuple[int, int]
    hold_ns: int
    end_ns: int


def plan(cell: Cell) -> CellPlan:
    """The schedule of `cell`; it takes longer with delay and blackouts."""
    hand, (nx, ny) = cell.bench_hand, cell.normal
    round_trip_s = (cell.delay + cell.jitter) / 1000.0
    wall_m = cell.place / 1000.0
    script: list[Waypoint] = []
    phases: list[str] = []

    def go(phase: str, ahead_m: float, across_m: float, move_s: float, stay_s: float = 0.0) -> None:
        x, y = ahead_m * nx - across_m * ny, ahead_m * ny + across_m * nx
        script.append(Waypoint(x, y, _ns(move_s), _ns(stay_s)))
        phases.append(phase)

    def press(phase: str, stay_s: float) -> None:
        go(phase, wall_m + hand.depth_m, 0.0, hand.press_s, stay_s)
        go(REST if phase == LAST else FREE, 0.0, 0.0, hand.back_s)

    def move(seconds: int) -> None:
        for number in range(4 * seconds if hand.taps else seconds):
            if hand.taps:
                for ahead_m in (wall_m + hand.depth_m, wall_m - hand.depth_m):
                    go(FREE, ahead_m, -0.05, 0.125)
            else:
                go(FREE, -0.03, 0.04 if number % 2 else -0.04, 1.0)

    # The session begins after one and a half round trips, unless samples are lost.
    go(START, 0.0, 0.0, 0.0, 0.5 + 3.0 * round_trip_s)
    move(round(cell.free))
    press(FIRST, 1.5 + 3.0 * round_trip_s)
    move(1)
    free = len(script)
    move(1)
    second, began_s = len(script), _seconds(script)
    into_s = hand.press_s + 1.0
    dark: list[tuple[int, int]] = []
    for _ in range(3 if cell.blackout else 0):
        dark.append((_ns(began_s + into_s), _ns(began_s + into_s + cell.blackout)))
        into_s += cell.blackout + _RECOVERY_S + 2.0 * round_trip_s
    stay_s = into_s - hand.press_s + FELT_AFTER_S + 1.5 + 2.0 * round_trip_s
    press(SECOND, stay_s)
    move(3)
    hold_s = max(_HOLD_S, _HOLD_ROUND_TRIPS * round_trip_s)
    press(LAST, _RECOVERY_S + 2.0 * round_trip_s + hold_s)
    go(REST, 0.0, 0.0, 0.0, 3.0 + 2.0 * round_trip_s)
    return CellPlan(
        script=tuple(script),
        phases=tuple(phases),
        down_dark=tuple(dark[:2]),
        up_dark=tuple(dark[::2]),
        restart=(second, _ns(into_s)) if cell.at == "contact" else (free, _ns(0.1)),
        leaves=(second, _ns(into_s + FELT_AFTER_S + 0.3)),
        hold_ns=_ns(hold_s),
        end_ns=_ns(_seconds(script)),
    )


def _seconds(script: list[Waypoint]) -> float:
    return sum(point.move_ns + point.stay_ns for point in script) / 1e9


def _ns(seconds: float) -> int:
    """In whole cycles of 1 ms."""
    return round(seconds * 1000) * NS_PER_MS

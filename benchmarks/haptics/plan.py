"""The schedule of a run of a cell: the motion of the hand, and the blackouts. A core.

First the hand touches the three targets in turn, or taps the first one at 4 Hz. Then it presses the
first one and holds it, then it goes back to the middle. One blackout of both ways falls into the
touches. While the hand presses, one blackout of the commands and one of the feedback follow. The
hold begins after the last one, with time to recover.
"""

from dataclasses import dataclass

from benchmarks.haptics.cell import Cell
from benchmarks.haptics.hands import HANDS
from kontur_av.clock import NS_PER_MS, NS_PER_S
from telepresence.haptics.board import WALL_X_M
from telepresence.haptics.hand import Waypoint

_TARGETS_Y_M = (-0.05, 0.0, 0.05)
#: The intended depth of the hand behind the wall, as when pressing a button.
DEPTH_M = 0.025
_AWAY_M = 0.04
#: An oscillation of the delayed loop has a period of 2 to 4 round trips; the hold has three thirds.
_HOLD_ROUND_TRIPS = 12.0
_RECOVERY_S = 2.0


@dataclass(frozen=True, slots=True)
class CellPlan:
    """script: waypoints of the hand. down_dark, up_dark: blackouts of commands and of feedback.

    All spans are (begin, end) in ns. hold_ns: in which a stable loop comes to rest. end_ns: of the
    run.
    """

    script: tuple[Waypoint, ...]
    down_dark: tuple[tuple[int, int], ...]
    up_dark: tuple[tuple[int, int], ...]
    hold_ns: tuple[int, int]
    end_ns: int


def plan(cell: Cell, seconds: float) -> CellPlan:
    """Half of `seconds` for touches and half for the hold; more for delay and blackouts."""
    round_trip_s = (cell.delay + cell.jitter) / 1000.0
    recovery_s = _RECOVERY_S + 2.0 * round_trip_s
    touch_s = seconds / 2.0
    if cell.blackout:
        touch_s += cell.blackout + recovery_s
    script: list[Waypoint] = []
    while _duration_s(script) < touch_s:
        if HANDS[cell.hand].taps:
            script += _tap(_TARGETS_Y_M[0])
        else:
            script += _touch(_TARGETS_Y_M[len(script) // 2 % 3])
    touched_s = _duration_s(script)

    press_s = touched_s + 1.0 + recovery_s
    dark: list[tuple[float, float]] = []
    if cell.blackout:
        # In the middle of a press of the second target.
        dark.append((2.7, 2.7 + cell.blackout))
        dark.append((press_s, press_s + cell.blackout))
        press_s += cell.blackout + recovery_s
        dark.append((press_s, press_s + cell.blackout))
        press_s += cell.blackout + recovery_s
    hold_end_s = press_s + max(seconds / 2.0, _HOLD_ROUND_TRIPS * round_trip_s)
    script.append(_waypoint(WALL_X_M + DEPTH_M, _TARGETS_Y_M[0], 1.0, hold_end_s - touched_s - 1))
    script.append(_waypoint(0.0, 0.0, 1.0, 10.0 + recovery_s))
    end_s = hold_end_s + 1.0 + recovery_s
    spans = [(_ns(begin), _ns(end)) for begin, end in dark]
    return CellPlan(
        script=tuple(script),
        down_dark=tuple(spans[:2]),
        up_dark=tuple(spans[::2]),
        hold_ns=(_ns(press_s), _ns(hold_end_s)),
        end_ns=_ns(end_s),
    )


def _touch(y_m: float) -> list[Waypoint]:
    return [
        _waypoint(WALL_X_M + DEPTH_M, y_m, 0.6, 0.5),
        _waypoint(WALL_X_M - _AWAY_M, y_m, 0.5, 0.2),
    ]


def _tap(y_m: float) -> list[Waypoint]:
    return [
        _waypoint(WALL_X_M + DEPTH_M, y_m, 0.125, 0.0),
        _waypoint(WALL_X_M - DEPTH_M, y_m, 0.125, 0.0),
    ]


def _waypoint(x_m: float, y_m: float, move_s: float, stay_s: float) -> Waypoint:
    return Waypoint(x_m, y_m, _ns(move_s), _ns(stay_s))


def _duration_s(script: list[Waypoint]) -> float:
    return sum(point.move_ns + point.stay_ns for point in script) / NS_PER_S


def _ns(seconds: float) -> int:
    """In whole cycles of 1 ms."""
    return round(seconds * 1000) * NS_PER_MS

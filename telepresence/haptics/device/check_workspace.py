"""Workspace: how far the handle moves to each side, pushed by motors or moved by a person."""

from kontur_av.clock import NS_PER_S
from telepresence.haptics.device.check import CheckResult, CheckScript, Figure
from telepresence.haptics.device.device import JoystickFacts
from telepresence.haptics.device.script import IDLE, Cycle, Output, push_to_stop, travel

NAME = "workspace"

_PUSH_N = 4.0
#: Accepted distance of an end, as a share of the nominal half workspace. Chosen.
_LEAST, _MOST = 0.95, 1.05
#: A stick must only come near its nominal end, because sticks vary in mechanics and range.
_STICK_SHARE = 0.9
_PATIENCE_NS = 15 * NS_PER_S
_SIDES = (("left", (-1, 0)), ("right", (1, 0)), ("lower", (0, -1)), ("upper", (0, 1)))


def workspace_check(facts: JoystickFacts) -> CheckScript:
    """Return the script: about 6 s with motors; without, until all ends are reached or 15 s."""
    return _pushed(facts) if facts.has_force else _moved(facts)


def _pushed(facts: JoystickFacts) -> CheckScript:
    cycle: Cycle = yield IDLE
    figures: list[Figure] = []
    force_n = min(_PUSH_N, facts.force_limit_n)
    for side, direction in _SIDES:
        axis = 0 if direction[0] else 1
        cycle, there = yield from travel(cycle, 0.0, 0.0, speed_m_s=0.3)
        if not there:
            return CheckResult(NAME, tuple(figures), "the handle does not reach the middle")
        cycle, end = yield from push_to_stop(cycle, direction, force_n=force_n)
        nominal_m = facts.half_width_m if axis == 0 else facts.half_height_m
        figures.append(_figure(side, abs(end.place(axis)), nominal_m, _LEAST, _MOST))
    cycle, there = yield from travel(cycle, 0.0, 0.0, speed_m_s=0.3)
    trouble = "" if there else "the handle does not return to the middle"
    return CheckResult(NAME, tuple(figures), trouble)


def _moved(facts: JoystickFacts) -> CheckScript:
    cycle: Cycle = yield IDLE
    reached_m = [0.0] * len(_SIDES)
    halves = [facts.half_width_m if side[0] else facts.half_height_m for _, side in _SIDES]
    until_ns = cycle.now_ns + _PATIENCE_NS
    while cycle.now_ns < until_ns and any(
        reached < _STICK_SHARE * half for reached, half in zip(reached_m, halves, strict=True)
    ):
        reading = cycle.reading
        for index, (_, (along_x, along_y)) in enumerate(_SIDES):
            place_m = along_x * reading.x_m + along_y * reading.y_m
            reached_m[index] = max(reached_m[index], place_m)
        cycle = yield Output(prompt="move the stick once round, along its edge")
    return CheckResult(
        NAME,
        tuple(
            _figure(side, reached, half, _STICK_SHARE, None)
            for (side, _), reached, half in zip(_SIDES, reached_m, halves, strict=True)
        ),
    )


def _figure(side: str, reached_m: float, half_m: float, least: float, most: float | None) -> Figure:
    half_mm = half_m * 1e3
    return Figure(
        f"{side} end",
        reached_m * 1e3,
        "mm",
        round(least * half_mm, 2),
        None if most is None else round(most * half_mm, 2),
    )

"""Virtual spring: is the displayed stiffness the commanded one?

The motors display a spring, on which the handle's mass oscillates. Its turning points are half a
period apart, π/ω. Coulomb friction reduces the amplitude but not the period, because the handle
oscillates about the ends of a dead band. The effect of viscous friction is known.

The displayed stiffness, m (ω² + (b/2m)²), thus follows from times alone. A check that compares
commanded forces would miss motors that exert less force than commanded.
"""

from math import pi

from kontur_av.clock import NS_PER_S
from telepresence.haptics.device.check import CheckResult, CheckScript, Figure
from telepresence.haptics.device.device import JoystickFacts
from telepresence.haptics.device.script import IDLE, SERVO, Cycle, Output, Script, travel

NAME = "spring"

STIFFNESS_N_M = 200.0
_DISPLACED_M = 0.03
#: Turning points used. The first one follows the release, where the motors' force steps.
_TURNS = 5
_PATIENCE_NS = 2 * NS_PER_S
_TOLERANCE = 0.1
#: The handle may rest anywhere in the dead band of its friction, plus this margin.
_REST_MARGIN_M = 0.001


def spring_check(facts: JoystickFacts) -> CheckScript:
    """Return the script; it takes about 4 s."""
    cycle: Cycle = yield IDLE
    if not facts.has_force:
        return CheckResult(NAME, skipped="this device has no motors to make a spring with")
    figures: list[Figure] = []
    for axis in (0, 1):
        cycle, found = yield from stiffness_figures(cycle, facts, axis)
        if found is None:
            trouble = f"axis {'xy'[axis]} does not move to where it is pushed"
            return CheckResult(NAME, tuple(figures), trouble)
        figures += found
    cycle, _ = yield from travel(cycle, 0.0, 0.0)
    return CheckResult(NAME, tuple(figures))


def stiffness_figures(
    cycle: Cycle, facts: JoystickFacts, axis: int
) -> Script[tuple[Cycle, list[Figure] | None]]:
    """Return the figures of one axis, or None if it does not move; it takes about 2 s."""
    name = "xy"[axis]
    start = (_DISPLACED_M, 0.0) if axis == 0 else (0.0, _DISPLACED_M)
    cycle, there = yield from travel(cycle, *start)
    if not there:
        return cycle, None
    cycle, turns_s = yield from _swing(cycle, axis)
    # The handle has come to rest, so it must lie within the dead band of its friction.
    rest_m = cycle.reading.place(axis)
    band_m = 1.6 * facts.coulomb_n / STIFFNESS_N_M + _REST_MARGIN_M
    return cycle, [
        Figure(
            f"stiffness {name}",
            _stiffness(turns_s, facts),
            "N/m",
            (1 - _TOLERANCE) * STIFFNESS_N_M,
            (1 + _TOLERANCE) * STIFFNESS_N_M,
        ),
        Figure(f"rest {name}", rest_m * 1e3, "mm", -band_m * 1e3, band_m * 1e3),
    ]


def _swing(cycle: Cycle, axis: int) -> Script[tuple[Cycle, list[float]]]:
    """Let the handle oscillate until it rests; return the instants (s) of its turning points."""
    turns_s: list[float] = []
    began_ns = cycle.now_ns
    before, before_ns = 0.0, cycle.now_ns
    while cycle.now_ns - began_ns < _PATIENCE_NS:
        reading = cycle.reading
        speed = reading.speed(axis)
        if before * speed < 0.0:
            share = before / (before - speed)
            turn_ns = before_ns + share * (cycle.now_ns - before_ns) - began_ns
            turns_s.append(turn_ns / NS_PER_S)
        if speed != 0.0:
            before, before_ns = speed, cycle.now_ns
        pull_n = -STIFFNESS_N_M * reading.place(axis)
        hold_x, hold_y = SERVO.force(reading, 0.0, 0.0)
        cycle = yield Output(pull_n, hold_y) if axis == 0 else Output(hold_x, pull_n)
    return cycle, turns_s


def _stiffness(turns_s: list[float], facts: JoystickFacts) -> float | None:
    used = turns_s[:_TURNS]
    if len(used) < 2:
        return None
    omega = pi * (len(used) - 1) / (used[-1] - used[0])
    return facts.mass_kg * (omega**2 + (facts.viscous_n_s_m / (2 * facts.mass_kg)) ** 2)

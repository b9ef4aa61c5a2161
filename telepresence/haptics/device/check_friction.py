"""Friction: the force that keeps the handle moving, at two speeds, in both directions and axes.

The motors hold a speed; the force that this takes in steady motion is friction alone. Two speeds
separate Coulomb friction, the same at any speed, from viscous friction.
"""

from kontur_av.clock import NS_PER_S
from telepresence.haptics.device.check import CheckResult, CheckScript, Figure
from telepresence.haptics.device.device import JoystickFacts
from telepresence.haptics.device.script import IDLE, SERVO, Cycle, Output, Script, travel

NAME = "friction"

_SPEEDS_M_S = (0.06, 0.18)
#: Travel of a run and its measured part, as shares of the half workspace.
_RUN = 0.7
_MEASURED = 0.4
#: Gains of the speed controller; it settles during the run-up for handles of 0.2 to 1 kg. Chosen.
_GAIN_N_S_M = 15.0
_INTEGRAL_N_M = 150.0
#: Healthy range as shares of the nominal value, with a margin for measurement errors. Chosen.
_LEAST, _MOST = 0.4, 1.6
_COULOMB_MARGIN_N, _VISCOUS_MARGIN_N_S_M = 0.05, 0.5


def friction_check(facts: JoystickFacts) -> CheckScript:
    """Return the script; it takes about 13 s."""
    cycle: Cycle = yield IDLE
    if not facts.has_force:
        return CheckResult(NAME, skipped="this device has no motors to move it with")
    figures: list[Figure] = []
    for axis, half_m in ((0, facts.half_width_m), (1, facts.half_height_m)):
        name = "xy"[axis]
        means: list[float] = []
        for speed_m_s in _SPEEDS_M_S:
            both: list[float] = []
            for sign in (-1, 1):
                start_m = -sign * _RUN * half_m
                start = (start_m, 0.0) if axis == 0 else (0.0, start_m)
                cycle, there = yield from travel(cycle, *start)
                if not there:
                    return CheckResult(
                        NAME, tuple(figures), f"axis {name} does not move to where it is pushed"
                    )
                cycle, mean_n = yield from _run(cycle, axis, sign * speed_m_s, half_m)
                if mean_n is None:
                    return CheckResult(
                        NAME, tuple(figures), f"axis {name} does not keep {speed_m_s:g} m/s"
                    )
                both.append(sign * mean_n)
            means.append(sum(both) / 2)
        low, high = means
        viscous = (high - low) / (_SPEEDS_M_S[1] - _SPEEDS_M_S[0])
        coulomb = low - viscous * _SPEEDS_M_S[0]
        nominal = facts.coulomb_n
        figures += [
            Figure(
                f"Coulomb friction {name}",
                coulomb,
                "N",
                _LEAST * nominal - _COULOMB_MARGIN_N,
                _MOST * nominal + _COULOMB_MARGIN_N,
            ),
            Figure(
                f"viscous friction {name}",
                viscous,
                "N s/m",
                None,
                _MOST * facts.viscous_n_s_m + _VISCOUS_MARGIN_N_S_M,
            ),
        ]
    cycle, _ = yield from travel(cycle, 0.0, 0.0)
    return CheckResult(NAME, tuple(figures))


def _run(
    cycle: Cycle, axis: int, speed_m_s: float, half_m: float
) -> Script[tuple[Cycle, float | None]]:
    """Hold `speed_m_s` along `axis`; return the mean force in the middle of the travel (N)."""
    sign = 1 if speed_m_s > 0 else -1
    until_ns = cycle.now_ns + round(2 * 2 * _RUN * half_m / abs(speed_m_s) * NS_PER_S) + NS_PER_S
    last_ns = cycle.now_ns
    gathered_n = total_n = 0.0
    count = 0
    while cycle.now_ns < until_ns:
        reading = cycle.reading
        place_m = sign * reading.place(axis)
        if place_m > _RUN * half_m:
            return cycle, total_n / count if count else None
        dt_s = (cycle.now_ns - last_ns) / NS_PER_S
        last_ns = cycle.now_ns
        error = speed_m_s - reading.speed(axis)
        gathered_n += _INTEGRAL_N_M * error * dt_s
        force_n = gathered_n + _GAIN_N_S_M * error
        if abs(place_m) < _MEASURED * half_m:
            total_n += force_n
            count += 1
        hold_x, hold_y = SERVO.force(reading, 0.0, 0.0)
        cycle = yield Output(force_n, hold_y) if axis == 0 else Output(hold_x, force_n)
    return cycle, None

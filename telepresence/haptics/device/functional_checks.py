"""The functional checks of a joystick, as scripts; `checks` runs them.

Workspace: how far the handle moves to each side, pushed by motors or moved by a person.

Friction: the motors hold a speed; the force that this takes in steady motion is friction alone. Two
speeds separate Coulomb friction, the same at any speed, from viscous friction.

Virtual spring: the handle's mass oscillates on a spring that the motors display. Its turning points
are half a period apart, π/ω. Coulomb friction changes the amplitude only. The displayed stiffness,
m (ω² + (b/2m)²), thus follows from times alone. To compare commanded forces would miss motors that
exert less force than commanded.

Buttons and LEDs: each LED asks for its button, all together for the dead-man button; without LEDs
the prompt asks in words.
"""

from math import pi

from kontur_av.clock import NS_PER_S
from telepresence.haptics.device.device import JoystickCapabilities
from telepresence.haptics.device.script import (
    IDLE,
    SERVO,
    CheckResult,
    CheckScript,
    Cycle,
    Figure,
    Output,
    Script,
    push_to_stop,
    travel,
)

WORKSPACE = "workspace"

_PUSH_N = 4.0
#: Accepted distance of an end, as a share of the nominal half workspace. Chosen.
_LEAST_SIDE, _MOST_SIDE = 0.95, 1.05
#: A stick must only come near its nominal end, because sticks vary in mechanics and range.
_STICK_SHARE = 0.9
_MOVE_TIMEOUT_NS = 15 * NS_PER_S
_SIDES = (("left", (-1, 0)), ("right", (1, 0)), ("lower", (0, -1)), ("upper", (0, 1)))


def workspace_check(capabilities: JoystickCapabilities) -> CheckScript:
    """Return the script: about 6 s with motors; without, until all ends are reached or 15 s."""
    return _pushed(capabilities) if capabilities.has_force else _moved(capabilities)


def _pushed(capabilities: JoystickCapabilities) -> CheckScript:
    cycle: Cycle = yield IDLE
    metrics: list[Figure] = []
    force_n = min(_PUSH_N, capabilities.force_limit_n)
    for side, direction in _SIDES:
        axis = 0 if direction[0] else 1
        cycle, there = yield from travel(cycle, 0.0, 0.0, speed_m_s=0.3)
        if not there:
            return CheckResult(WORKSPACE, tuple(metrics), "the handle does not reach the middle")
        cycle, end = yield from push_to_stop(cycle, direction, force_n=force_n)
        nominal_m = capabilities.half_width_m if axis == 0 else capabilities.half_height_m
        metrics.append(_figure(side, abs(end.position(axis)), nominal_m, _LEAST_SIDE, _MOST_SIDE))
    cycle, there = yield from travel(cycle, 0.0, 0.0, speed_m_s=0.3)
    trouble = "" if there else "the handle does not return to the middle"
    return CheckResult(WORKSPACE, tuple(metrics), trouble)


def _moved(capabilities: JoystickCapabilities) -> CheckScript:
    cycle: Cycle = yield IDLE
    reached_m = [0.0] * len(_SIDES)
    halves = [
        capabilities.half_width_m if side[0] else capabilities.half_height_m for _, side in _SIDES
    ]
    until_ns = cycle.now_ns + _MOVE_TIMEOUT_NS
    while cycle.now_ns < until_ns and any(
        reached < _STICK_SHARE * half for reached, half in zip(reached_m, halves, strict=True)
    ):
        reading = cycle.reading
        for index, (_, (along_x, along_y)) in enumerate(_SIDES):
            position_m = along_x * reading.x_m + along_y * reading.y_m
            reached_m[index] = max(reached_m[index], position_m)
        cycle = yield Output(prompt="move the stick once round, along its edge")
    return CheckResult(
        WORKSPACE,
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


FRICTION = "friction"

_SPEEDS_M_S = (0.06, 0.18)
#: Travel of a run and its measured part, as shares of the half workspace.
_RUN = 0.7
_MEASURED = 0.4
#: Gains of the speed controller; it settles during the run-up for handles of 0.2 to 1 kg. Chosen.
_GAIN_N_S_M = 15.0
_INTEGRAL_N_M = 150.0
#: Healthy range as shares of the nominal value, with a margin for measurement errors. Chosen.
_LEAST_FRICTION, _MOST_FRICTION = 0.4, 1.6
_COULOMB_MARGIN_N, _VISCOUS_MARGIN_N_S_M = 0.05, 0.5


def friction_check(capabilities: JoystickCapabilities) -> CheckScript:
    """Return the script; it takes about 13 s."""
    cycle: Cycle = yield IDLE
    if not capabilities.has_force:
        return CheckResult(FRICTION, skipped="this device has no motors to move it with")
    metrics: list[Figure] = []
    for axis, half_m in ((0, capabilities.half_width_m), (1, capabilities.half_height_m)):
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
                        FRICTION, tuple(metrics), f"axis {name} does not move to where it is pushed"
                    )
                cycle, mean_n = yield from _run(cycle, axis, sign * speed_m_s, half_m)
                if mean_n is None:
                    return CheckResult(
                        FRICTION, tuple(metrics), f"axis {name} does not keep {speed_m_s:g} m/s"
                    )
                both.append(sign * mean_n)
            means.append(sum(both) / 2)
        low, high = means
        viscous = (high - low) / (_SPEEDS_M_S[1] - _SPEEDS_M_S[0])
        coulomb = low - viscous * _SPEEDS_M_S[0]
        nominal = capabilities.coulomb_n
        metrics += [
            Figure(
                f"Coulomb friction {name}",
                coulomb,
                "N",
                _LEAST_FRICTION * nominal - _COULOMB_MARGIN_N,
                _MOST_FRICTION * nominal + _COULOMB_MARGIN_N,
            ),
            Figure(
                f"viscous friction {name}",
                viscous,
                "N s/m",
                None,
                _MOST_FRICTION * capabilities.viscous_n_s_m + _VISCOUS_MARGIN_N_S_M,
            ),
        ]
    cycle, _ = yield from travel(cycle, 0.0, 0.0)
    return CheckResult(FRICTION, tuple(metrics))


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
        position_m = sign * reading.position(axis)
        if position_m > _RUN * half_m:
            return cycle, total_n / count if count else None
        dt_s = (cycle.now_ns - last_ns) / NS_PER_S
        last_ns = cycle.now_ns
        error = speed_m_s - reading.speed(axis)
        gathered_n += _INTEGRAL_N_M * error * dt_s
        force_n = gathered_n + _GAIN_N_S_M * error
        if abs(position_m) < _MEASURED * half_m:
            total_n += force_n
            count += 1
        hold_x, hold_y = SERVO.force(reading, 0.0, 0.0)
        cycle = yield Output(force_n, hold_y) if axis == 0 else Output(hold_x, force_n)
    return cycle, None


SPRING = "spring"

STIFFNESS_N_M = 200.0
_DISPLACED_M = 0.03
#: Turning points used. The first one follows the release, where the motors' force steps.
_TURNS = 5
_REST_TIMEOUT_NS = 2 * NS_PER_S
_TOLERANCE = 0.1
#: The handle may rest anywhere in the dead band of its friction, plus this margin.
_REST_MARGIN_M = 0.001


def spring_check(capabilities: JoystickCapabilities) -> CheckScript:
    """Return the script; it takes about 4 s."""
    cycle: Cycle = yield IDLE
    if not capabilities.has_force:
        return CheckResult(SPRING, skipped="this device has no motors to make a spring with")
    metrics: list[Figure] = []
    for axis in (0, 1):
        cycle, found = yield from stiffness_metrics(cycle, capabilities, axis)
        if found is None:
            trouble = f"axis {'xy'[axis]} does not move to where it is pushed"
            return CheckResult(SPRING, tuple(metrics), trouble)
        metrics += found
    cycle, _ = yield from travel(cycle, 0.0, 0.0)
    return CheckResult(SPRING, tuple(metrics))


def stiffness_metrics(
    cycle: Cycle, capabilities: JoystickCapabilities, axis: int
) -> Script[tuple[Cycle, list[Figure] | None]]:
    """Return the figures of one axis, or None if it does not move; it takes about 2 s."""
    name = "xy"[axis]
    start = (_DISPLACED_M, 0.0) if axis == 0 else (0.0, _DISPLACED_M)
    cycle, there = yield from travel(cycle, *start)
    if not there:
        return cycle, None
    cycle, turns_s = yield from _swing(cycle, axis)
    # The handle has come to rest, so it must lie within the dead band of its friction.
    rest_m = cycle.reading.position(axis)
    band_m = 1.6 * capabilities.coulomb_n / STIFFNESS_N_M + _REST_MARGIN_M
    return cycle, [
        Figure(
            f"stiffness {name}",
            _stiffness(turns_s, capabilities),
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
    while cycle.now_ns - began_ns < _REST_TIMEOUT_NS:
        reading = cycle.reading
        speed = reading.speed(axis)
        if before * speed < 0.0:
            share = before / (before - speed)
            turn_ns = before_ns + share * (cycle.now_ns - before_ns) - began_ns
            turns_s.append(turn_ns / NS_PER_S)
        if speed != 0.0:
            before, before_ns = speed, cycle.now_ns
        pull_n = -STIFFNESS_N_M * reading.position(axis)
        hold_x, hold_y = SERVO.force(reading, 0.0, 0.0)
        cycle = yield Output(pull_n, hold_y) if axis == 0 else Output(hold_x, pull_n)
    return cycle, turns_s


def _stiffness(turns_s: list[float], capabilities: JoystickCapabilities) -> float | None:
    used = turns_s[:_TURNS]
    if len(used) < 2:
        return None
    omega = pi * (len(used) - 1) / (used[-1] - used[0])
    return capabilities.mass_kg * (
        omega**2 + (capabilities.viscous_n_s_m / (2 * capabilities.mass_kg)) ** 2
    )


BUTTONS = "buttons"

#: Time that a person has for each press and for each release.
BUTTON_TIMEOUT_NS = 4 * NS_PER_S


def buttons_check(capabilities: JoystickCapabilities) -> CheckScript:
    """Return the script; its duration depends on the person, at most 8 s a button."""
    cycle: Cycle = yield IDLE
    cycle, metrics = yield from each_button(cycle, capabilities)
    all_leds = (1 << capabilities.leds) - 1
    seen = 0
    # Begin with the opposite of the present state, so that both states are seen.
    for wanted_on in (False, True) if cycle.reading.dead_man else (True, False, True):
        words = "press the dead-man button" if wanted_on else "let go of the dead-man button"
        output = Output(leds=all_leds if wanted_on else 0, prompt=words)
        cycle, came = yield from _await_dead_man(cycle, output, wanted_on)
        if not came:
            break
        seen |= 1 << wanted_on
    metrics.append(Figure("dead-man button let go and pressed", float(seen == 3), "", 1, 1))
    return CheckResult(BUTTONS, tuple(metrics))


def each_button(
    cycle: Cycle, capabilities: JoystickCapabilities
) -> Script[tuple[Cycle, list[Figure]]]:
    """Ask for each button but the dead-man button; return two figures of each."""
    metrics: list[Figure] = []
    for index in range(capabilities.buttons):
        bit = 1 << index
        leds = bit if index < capabilities.leds else 0
        pressed, wrong = False, 0
        for wanted in (bit, 0):
            words = f"press button {index + 1}" if wanted else f"let go of button {index + 1}"
            # The LED goes out with the press, which shows the person that it was noticed.
            output = Output(leds=leds if wanted else 0, prompt=words)
            cycle, came, others = yield from _await_buttons(cycle, output, bit, wanted)
            wrong |= others
            if not came:
                break
            pressed = not wanted
        metrics += [
            Figure(f"button {index + 1} pressed and let go", float(pressed), "", 1, 1),
            Figure(f"other buttons with {index + 1}", float(wrong.bit_count()), "", 0, 0),
        ]
    return cycle, metrics


def _await_buttons(
    cycle: Cycle, output: Output, bit: int, wanted: int
) -> Script[tuple[Cycle, bool, int]]:
    others = 0
    until_ns = cycle.now_ns + BUTTON_TIMEOUT_NS
    while cycle.now_ns < until_ns:
        others |= cycle.reading.buttons & ~bit
        if cycle.reading.buttons & bit == wanted:
            return cycle, True, others
        cycle = yield output
    return cycle, False, others


def _await_dead_man(cycle: Cycle, output: Output, wanted: bool) -> Script[tuple[Cycle, bool]]:
    until_ns = cycle.now_ns + BUTTON_TIMEOUT_NS
    while cycle.now_ns < until_ns:
        if cycle.reading.dead_man == wanted:
            return cycle, True
        cycle = yield output
    return cycle, False

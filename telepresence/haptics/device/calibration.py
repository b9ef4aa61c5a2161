"""The script that finds the middle of a joystick's workspace."""

from typing import NamedTuple

from kontur_av.clock import NS_PER_MS
from telepresence.haptics.device.device import JoystickCapabilities
from telepresence.haptics.device.script import IDLE, Cycle, Output, Script, push_to_stop, travel

#: Force of the push (N): more than the handle's friction, and harmless for fingers. Chosen.
PUSH_N = 5.0
_SPEED_M_S = 0.6
#: Tolerated difference between the measured half width and the nominal one, as a share. A larger
#: one means a faulty encoder or a blocked axis. Chosen.
TOLERANCE = 0.08
_REST_NS = 300 * NS_PER_MS
#: A stick that rests farther from its electrical middle is being held.
_REST_SHARE = 0.15


class Calibration(NamedTuple):
    """The result: subtract (x_m, y_m) from the encoders' positions.

    half_width_m, half_height_m: measured, or nominal if nothing can be measured.
    problem: one line that says why the calibration failed; "" if it passed.
    """

    x_m: float = 0.0
    y_m: float = 0.0
    half_width_m: float = 0.0
    half_height_m: float = 0.0
    problem: str = ""


def calibrate(capabilities: JoystickCapabilities) -> Script[Calibration]:
    """Return the script that finds the middle of the workspace of a device with these facts.

    Motors push the handle to its stops. A stick springs back to its middle, and is left alone.
    """
    return _with_motors(capabilities) if capabilities.has_force else _without_motors(capabilities)


def _with_motors(capabilities: JoystickCapabilities) -> Script[Calibration]:
    cycle: Cycle = yield IDLE
    middles: list[float] = []
    halves: list[float] = []
    push_n = min(PUSH_N, capabilities.force_limit_n)
    for axis, nominal_m in ((0, capabilities.half_width_m), (1, capabilities.half_height_m)):
        name = "xy"[axis]
        ends = []
        for sign in (-1, 1):
            direction = (sign, 0) if axis == 0 else (0, sign)
            cycle, end = yield from push_to_stop(
                cycle, direction, force_n=push_n, speed_m_s=_SPEED_M_S
            )
            ends.append(end.position(axis))
        half_m = (ends[1] - ends[0]) / 2
        if abs(half_m - nominal_m) > TOLERANCE * nominal_m:
            return Calibration(
                problem=f"axis {name} moves by ±{half_m * 1e3:.0f} mm where "
                f"±{nominal_m * 1e3:.0f} mm are due: free the handle and calibrate again"
            )
        middles.append((ends[0] + ends[1]) / 2)
        halves.append(half_m)
        to_x = middles[0] if axis == 0 else cycle.reading.x_m
        to_y = middles[1] if axis == 1 else cycle.reading.y_m
        cycle, there = yield from travel(cycle, to_x, to_y, speed_m_s=_SPEED_M_S, force_n=push_n)
        if not there:
            return Calibration(
                problem=f"axis {name} does not return to its middle: free the handle, let go of "
                "it, and calibrate again"
            )
    return Calibration(middles[0], middles[1], halves[0], halves[1])


def _without_motors(capabilities: JoystickCapabilities) -> Script[Calibration]:
    cycle: Cycle = yield IDLE
    until_ns = cycle.now_ns + _REST_NS
    xs, ys = [cycle.reading.x_m], [cycle.reading.y_m]
    while cycle.now_ns < until_ns:
        cycle = yield Output(prompt="leave the stick alone")
        xs.append(cycle.reading.x_m)
        ys.append(cycle.reading.y_m)
    x_m, y_m = sum(xs) / len(xs), sum(ys) / len(ys)
    for values, middle, half_m in (
        (xs, x_m, capabilities.half_width_m),
        (ys, y_m, capabilities.half_height_m),
    ):
        moved = max(abs(value) for value in values)
        if moved > _REST_SHARE * half_m or max(values) - min(values) > _REST_SHARE / 3 * half_m:
            return Calibration(
                problem=f"the stick does not rest at its middle ({middle / half_m:+.0%} of its "
                "travel): let go of it, and calibrate again"
            )
    return Calibration(x_m, y_m, capabilities.half_width_m, capabilities.half_height_m)

"""A policy at the handle: what its program returns, checked at one door, and what it says. Cores.

A place is where the robot is to be, one number for each of its axes: m, of rotations rad.
"""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from kontur_av.clock import NS_PER_S
from kontur_av.returned import PartError, fault_of, one_line, plain
from telepresence.haptics.axes import AxisName, built_in_axis
from telepresence.haptics.device.page import CAPABILITIES, NO_PICTURE

#: Actions up to so far ahead count (s): a program that hangs moves the robot for no longer.
MOST_AHEAD_S = 2.0
_MOST_ACTIONS = 256
#: Nothing of a robot is so far (m, rad).
_MOST = 1000.0

Place = tuple[float, ...]


def taken_action(
    returned: Any, rest: Mapping[str, float], period_s: float
) -> list[tuple[float, Place]]:
    """Return what a policy's `step` returned, as seconds after the observation and places.

    returned: an action; a chunk of them, one each `period_s`, or as a mapping of seconds to
    actions; None lets go. An action is one number for each axis, in the order of `rest`, or a
    mapping of axes' names, where the other axes have the place of `rest`.
    Raises PartError, in one line, for everything else.
    """
    if returned is None:
        return []
    try:
        chunk = {0.0: returned}
        if isinstance(returned, Mapping):
            if not any(isinstance(key, str) for key in returned):
                chunk = dict(returned)
        elif isinstance(returned[0], Mapping) or np.ndim(returned[0]):
            chunk = {period_s * at: action for at, action in enumerate(returned)}
        found = [(_number(at, "a time"), _place(action, rest)) for at, action in chunk.items()]
    except PartError:
        raise
    except Exception as error:
        raise PartError(fault_of("step()", error)) from None
    return [each for each in sorted(found) if 0.0 <= each[0] <= MOST_AHEAD_S][:_MOST_ACTIONS]


def _place(action: Any, rest: Mapping[str, float]) -> Place:
    axes = ", ".join(rest)
    if isinstance(action, Mapping):
        if not action.keys() <= rest.keys():
            raise PartError(f"step() returned {one_line([*action])}: the axes are {axes}")
        action = list((dict(rest) | dict(action)).values())
    if isinstance(action, str) or len(action) != len(rest):
        raise PartError(f"step() returned {one_line(action)}: give a number for each of {axes}")
    return tuple(map(_number, action, rest))


def _number(value: Any, name: str) -> float:
    number = float(plain(value))
    if not -_MOST < number < _MOST:
        raise PartError(f"step() returned {name} = {number:g}: give a number in m, rad or s")
    return number


class PolicyMessage(NamedTuple):
    """What a policy's program says after each step. Instants are of the session's clock.

    name: of the policy. program: number of its process. seen: the robot's place at `seen_ns`.
    times_ns, places: its newest actions; none: it lets go. until_ns: from then on the program is
    silent. picture_ns: as `PageInput` has it. shadow: it is never obeyed. fault: one line, if its
    step failed.
    """

    name: str
    program: int
    seen: Place
    seen_ns: int
    times_ns: tuple[int, ...] = ()
    places: tuple[Place, ...] = ()
    until_ns: int = 0
    picture_ns: int = NO_PICTURE
    shadow: bool = False
    fault: str = ""

    def fits(self, axes: int, now_ns: int) -> bool:
        """Whether the program of a policy of so many axes can have said this now."""
        places = (self.seen, *self.places)
        return (
            all(len(place) == axes for place in places)
            and all(-_MOST < value < _MOST for place in places for value in place)
            and len(self.times_ns) == len(self.places) <= _MOST_ACTIONS
            and self.until_ns <= now_ns + 2 * MOST_AHEAD_S * NS_PER_S
        )

    def place_at(self, now_ns: int) -> Place:
        """Return where the robot is to be now; empty: nowhere, because the program is silent."""
        if not self.places or now_ns >= self.until_ns:
            return ()
        return tuple(
            float(np.interp(now_ns, self.times_ns, values))
            for values in zip(*self.places, strict=True)
        )


class PolicyAxis(NamedTuple):
    """An axis as a policy has it. half: the handle's half range. scale, rate: as of the setup."""

    name: str
    half: float
    scale: float = 1.0
    rate: bool = False


def policy_axes(names: Sequence[str], more: Sequence[AxisName]) -> tuple[PolicyAxis, ...]:
    """Return the axes of a setup: x and y first, as far as it has them, then those behind."""
    halves = {"x": CAPABILITIES.half_width_m, "y": CAPABILITIES.half_height_m}
    plane = [PolicyAxis(name, half) for name, half in halves.items() if name in names]
    behind = [(axis, built_in_axis(axis).half_range, axis.settings) for axis in more]
    return (
        *plane,
        *(PolicyAxis(str(axis), half, own.scale, own.mode == "rate") for axis, half, own in behind),
    )

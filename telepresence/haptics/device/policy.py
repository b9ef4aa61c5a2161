"""A policy at the handle: what its program returns, checked at one door, and its hand. Cores.

A policy says where the robot is to be, in the robot's units: m, of rotations rad. Its hand moves
the handle of `PageDevice` as a person at a page does: it presses the dead-man button once, from
where the robot is. After any interruption it lets go, and a person must hand over anew.
"""

from collections.abc import Mapping, Sequence
from itertools import pairwise
from math import isfinite
from typing import Any, NamedTuple

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.returned import PartError, fault_of, one_line, plain
from telepresence.haptics.axes import AxisName, built_in_axis
from telepresence.haptics.device.page import CAPABILITIES, NO_PICTURE, PageInput

#: Of a chunk, actions up to so far ahead count: a hung program moves the robot for no longer.
MOST_AHEAD_S = 2.0
_MOST_ACTIONS = 256
#: Nothing of a robot is so far (m, rad).
_MOST = 1000.0
#: The robot rests for this long before the press.
_HOLD_NS = 200 * NS_PER_MS
#: How long the robot may take to wait for the press, and then to follow.
_PATIENCE_NS = 5 * NS_PER_S
#: The joystick tells its state every 100 ms.
_SILENT_NS = 500 * NS_PER_MS
#: The handle's greatest speed, in half ranges a second: about 0.25 m/s. Chosen.
_HALVES_S = 2.5
_MOST_STEP_NS = 50 * NS_PER_MS

#: By axis, where the robot is to be; None: where it was last wanted.
Place = tuple[float | None, ...]


class ActionChunk(NamedTuple):
    """Several actions, and when each counts: seconds after the observation, growing.

    times_s: None: one period after the other, the first at once. Between them the place is
    interpolated; the last one stays.
    """

    actions: Any
    times_s: Any = None


def taken_action(
    returned: Any, axes: Sequence[str], period_s: float
) -> list[tuple[float, Place]] | None:
    """Return what a policy's `step` returned as (seconds, place); None: it lets go.

    returned: an action, several of them (one period after the other), or an `ActionChunk`. An
    action is a mapping of axes' names, or one number for each of `axes`; numbers may be numpy's.
    Raises PartError, one line, for everything else.
    """
    if returned is None:
        return None
    actions, times_s = returned if isinstance(returned, ActionChunk) else (returned, None)
    try:
        rows = [actions] if isinstance(actions, Mapping) else list(actions)
        if rows and not isinstance(rows[0], Mapping) and not hasattr(rows[0], "__len__"):
            rows = [rows]
        places = [_place(row, axes) for row in rows[:_MOST_ACTIONS]]
        ahead_s = [period_s * at for at in range(len(places))]
        if times_s is not None:
            ahead_s = [_number(each, "times_s") for each in times_s][:_MOST_ACTIONS]
    except PartError:
        raise
    except Exception as error:
        raise PartError(fault_of("step()", error)) from None
    grows = all(before < after for before, after in pairwise(ahead_s))
    if not places or len(ahead_s) != len(places) or not grows:
        raise PartError(f"step() returned {len(places)} actions, {len(ahead_s)} growing times")
    chunk = list(zip(ahead_s, places, strict=True))
    return [each for each in chunk if each[0] <= MOST_AHEAD_S] or chunk[:1]


def _place(action: Any, axes: Sequence[str]) -> Place:
    if isinstance(action, Mapping):
        if unknown := {*map(str, action)} - {*axes}:
            words = one_line(", ".join(sorted(unknown)))
            raise PartError(f"step() returned {words}: the axes are {', '.join(axes)}")
        return tuple(_number(action[name], name) if name in action else None for name in axes)
    if isinstance(action, str) or len(action) != len(axes):
        raise PartError(f"step() returned {one_line(action)!r}: give a number for each of {axes}")
    return tuple(_number(value, name) for value, name in zip(action, axes, strict=True))


def _number(value: Any, name: str) -> float:
    number = float(plain(value))
    if not -_MOST < number < _MOST:
        raise PartError(f"step() returned {name} = {number:g}: give a number in m or rad")
    return number


class PolicyMessage(NamedTuple):
    """What a policy's program says after each step. Instants are of the session's clock.

    name: of the policy. seen: the robot's place by axis, at `seen_ns`.
    times_ns, places: its newest actions; none: it lets go. keep_ns: so long after the last of them
    the program is silent. picture_ns: as `PageInput` has it. shadow: it is never obeyed.
    fault: one line, if its step failed.
    """

    name: str
    seen: tuple[float, ...]
    seen_ns: int
    times_ns: tuple[int, ...] = ()
    places: tuple[Place, ...] = ()
    keep_ns: int = 500 * NS_PER_MS
    picture_ns: int = NO_PICTURE
    shadow: bool = False
    fault: str = ""

    def fits(self, axes: int, now_ns: int) -> bool:
        """Whether a policy of so many axes can have said this."""
        wanted = [value for place in self.places for value in place if value is not None]
        return (
            len(self.seen) == axes
            and all(len(place) == axes for place in self.places)
            and len(self.times_ns) == len(self.places) <= _MOST_ACTIONS
            and all(isfinite(value) for value in (*self.seen, *wanted))
            and all(at < now_ns + 2 * MOST_AHEAD_S * NS_PER_S for at in self.times_ns)
            and list(self.times_ns) == sorted({*self.times_ns})
            and 0 <= self.keep_ns <= MOST_AHEAD_S * NS_PER_S
        )

    @property
    def until_ns(self) -> int:
        """From when on the program is silent."""
        return self.times_ns[-1] + self.keep_ns if self.times_ns else 0

    def place_at(self, now_ns: int) -> Place:
        """Return where the robot is to be now; empty: nowhere."""
        if now_ns >= self.until_ns:
            return ()
        before = after = 0
        while after < len(self.times_ns) - 1 and self.times_ns[after] < now_ns:
            before, after = after, after + 1
        began_ns, ends_ns = self.times_ns[before], self.times_ns[after]
        share = 1.0
        if began_ns < ends_ns:
            share = max(0.0, min(1.0, (now_ns - began_ns) / (ends_ns - began_ns)))
        return tuple(
            b if a is None or b is None else a + share * (b - a)
            for a, b in zip(self.places[before], self.places[after], strict=True)
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


class HeldState(NamedTuple):
    """What the joystick tells. places: of the handle, by the policy's axes, m or rad.

    ready: it is in the application. waits, stopped: what the robot says.
    """

    places: tuple[float, ...]
    ready: bool
    dead_man: bool
    waits: bool
    stopped: bool


class PolicyHand:
    """The hand of a policy: call `poll` every 10 ms, and pass what it returns to the joystick.

    name: of the policy. turn: it has the handle. pressed: it presses the dead-man button.
    late: presses that were repeated, because inputs came too late for the device.
    ended: why its newest turn ended, in one line. wanted: where it wants the robot, also while it
    has no turn; empty: nowhere.
    """

    def __init__(self, axes: Sequence[PolicyAxis]) -> None:
        self.axes = tuple(axes)
        self.turn = self.pressed = False
        self.ended, self.late = "", 0
        self.wanted: Place = ()
        self._message: PolicyMessage | None = None
        self._held: HeldState | None = None
        self._told_ns = self._began_ns = self._pressed_ns = self._polled_ns = 0
        #: The joystick, then the robot, have answered the press.
        self._holds = self._follows = False
        #: At the press: where the robot was, and where the handle was in shares. Then where it is.
        self._from: list[float] = []
        self._zero: list[float] = []
        self._shares: list[float] = []
        self._sequence = 0

    def handle_message(self, message: PolicyMessage, now_ns: int) -> None:
        """The program has said something; what it cannot have said ends its turn."""
        if not message.fits(len(self.axes), now_ns):
            message = message._replace(seen=(), times_ns=(), places=(), fault="malformed action")
        self._message = message
        if self.turn and not message.places:
            self.end(message.fault or "it let go")

    def handle_held(self, held: HeldState, now_ns: int) -> None:
        """The joystick has told its state."""
        self._held, self._told_ns = held, now_ns

    def hindrance(self, now_ns: int) -> str:
        """Return why it cannot have a turn now, or ""."""
        message, held = self._message, self._held
        if message is None or now_ns >= message.until_ns:
            return (message.fault if message else "") or "it is silent"
        if message.shadow:
            return "it only watches"
        if held is None or now_ns - self._told_ns > _SILENT_NS:
            return "the joystick is silent"
        if held.stopped:
            return "the emergency stop"
        return "" if held.ready else "the joystick is not in the application"

    def begin(self, now_ns: int) -> None:
        """A person hands over: hold, then press from where the robot is."""
        self.turn, self.ended, self._began_ns = True, "", now_ns

    def end(self, why: str) -> None:
        """Let go; a person must hand over anew."""
        self.turn = self.pressed = False
        self.ended = why

    def poll(self, now_ns: int) -> PageInput | None:
        """Return what to tell the joystick; None without a turn: who has it lets go."""
        step_ns = min(now_ns - self._polled_ns, _MOST_STEP_NS)
        self._polled_ns = now_ns
        self.wanted = () if self._message is None else self._message.place_at(now_ns)
        if not self.turn:
            return None
        if why := self.hindrance(now_ns) or self._interruption(now_ns):
            self.end(why)
            return None
        assert self._message is not None and self._held is not None
        if self.pressed:
            self._move(self._message.seen, _HALVES_S * step_ns / NS_PER_S)
        elif self._may_press(self._message, self._held, now_ns):
            self._press(self._message, self._held, now_ns)
        self._sequence += 1
        if not self.pressed:
            return PageInput(False, 0.0, 0.0, 0, self._sequence, now_ns)
        shares = dict(zip((axis.name for axis in self.axes), self._shares, strict=True))
        x, y = shares.pop("x", 0.0), shares.pop("y", 0.0)
        picture_ns, more = self._message.picture_ns, tuple(shares.values())
        return PageInput(True, x, y, 0, self._sequence, now_ns, picture_ns, more)

    def _interruption(self, now_ns: int) -> str:
        """Return what has happened since the turn began that needs a person, or ""."""
        held = self._held
        assert held is not None
        if not self.pressed:
            late = now_ns - self._began_ns > _PATIENCE_NS
            return "the robot does not wait for a press" if late else ""
        if self._told_ns <= self._pressed_ns:
            return ""
        if self._holds and not held.dead_man:
            # Our own process was late, and the device let go: hold, and press anew from there.
            self.pressed, self._began_ns, self.late = False, now_ns, self.late + 1
            return ""
        if self._follows and held.waits:
            return "the robot was interrupted"
        self._holds = self._holds or held.dead_man
        self._follows = self._holds and not held.waits
        late = not self._follows and now_ns - self._pressed_ns > _PATIENCE_NS
        return "the robot does not follow" if late else ""

    def _may_press(self, message: PolicyMessage, held: HeldState, now_ns: int) -> bool:
        """Whether robot and handle rest, and the program has seen where."""
        rests_ns = self._began_ns + _HOLD_NS
        fresh = message.seen_ns > rests_ns and self._told_ns > rests_ns and now_ns > rests_ns
        return fresh and held.waits and not held.dead_man

    def _press(self, message: PolicyMessage, held: HeldState, now_ns: int) -> None:
        self.pressed, self._pressed_ns = True, now_ns
        self._holds = self._follows = False
        self._from = list(message.seen)
        places = zip(self.axes, held.places, strict=True)
        self._zero = [_cut(place / axis.half) for axis, place in places]
        self._shares = list(self._zero)

    def _move(self, seen: Sequence[float], most: float) -> None:
        """Move the handle by at most so many shares, to where the robot is wanted."""
        for at, (axis, place) in enumerate(zip(self.axes, self.wanted, strict=True)):
            if axis.rate:
                ahead = 0.0 if place is None else (place - seen[at]) / axis.half
                share = ahead if axis.scale > 0.0 else -ahead
            elif place is None:
                continue
            else:
                share = self._zero[at] + (place - self._from[at]) / (axis.scale * axis.half)
            step = _cut(share) - self._shares[at]
            self._shares[at] += max(-most, min(most, step))


def _cut(share: float) -> float:
    return max(-1.0, min(1.0, share))

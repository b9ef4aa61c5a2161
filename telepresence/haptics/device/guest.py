"""A policy at a person's joystick: it moves a place of its own beside the device. A core.

While it drives, samples carry that place; the device is neither moved nor felt. A person who
presses the dead-man button of the device ends that at once. The robot then holds for a moment, and
the same press begins from where it is.
"""

from collections.abc import Sequence

from kontur_av.clock import NS_PER_MS
from telepresence.haptics.axes import MoreAxis, built_in_axis
from telepresence.haptics.device.page import CAPABILITIES, NO_PICTURE, PageHandModel, PageInput
from telepresence.haptics.device.stick import TAU_S, FollowedAxis

#: The robot rests for this long before the person's press counts, as before a policy's.
_HOLD_NS = 200 * NS_PER_MS
_FRESH_NS = PageHandModel().fresh_ns
#: The force that it may exert, which nobody feels, comes over this time, as at each press.
_FORCE_NS = 300 * NS_PER_MS


class HandleGuest:
    """The policy's hand. Call `step` in each cycle, behind the reading of the device.

    more: the axes behind x and y, which `step` moves.
    drives: its place counts, and its dead-man button. holds: the person's button does not yet.
    x_m, y_m: its place. force_share: 0 to 1. picture_ns: as of `PageInput`.
    """

    def __init__(self, more: Sequence[MoreAxis] = ()) -> None:
        self._axes = more
        self._halves = [built_in_axis(axis.capabilities.name).half_range for axis in more]
        self._x, self._y = FollowedAxis(TAU_S), FollowedAxis(TAU_S)
        self._more = [FollowedAxis(TAU_S, speed_m_s=axis.most_m_s) for axis in more]
        self._hand: PageInput | None = None
        self._fresh_ns = self._held_ns = self._hold_ns = 0
        #: It must let go before its button counts again.
        self._barred = False
        self.drives = False

    @property
    def x_m(self) -> float:
        return self._x.position

    @property
    def y_m(self) -> float:
        return self._y.position

    @property
    def holds(self) -> bool:
        return self._hold_ns > 0

    @property
    def force_share(self) -> float:
        return min(1.0, self._held_ns / _FORCE_NS)

    @property
    def picture_ns(self) -> int:
        return NO_PICTURE if self._hand is None else self._hand.picture_ns

    def handle_input(self, hand: PageInput, age_ns: int = 0) -> None:
        """Take an input of the policy that is `age_ns` old."""
        self._hand = hand
        self._fresh_ns = (hand.keeps_ns or _FRESH_NS) - max(age_ns, 0)
        if not hand.dead_man:
            self._barred = False

    def step(self, dt_ns: int, *, person: bool, allowed: bool) -> None:
        """`dt_ns` pass. person: presses the device's button. allowed: the application runs."""
        self._fresh_ns -= dt_ns
        self._hold_ns -= min(self._hold_ns, dt_ns)
        hand = self._hand
        if hand is None:
            return
        wanted = hand.dead_man and not self._barred
        drives = wanted and allowed and not person and self._fresh_ns > 0
        if wanted and not drives:
            self._barred = True
        if self.drives and not drives:
            self._hold_ns = _HOLD_NS
        begins, self.drives = drives and not self.drives, drives
        self._held_ns = self._held_ns + dt_ns if drives and not begins else 0
        if drives:
            self._follow(hand, dt_ns, begins=begins)

    def _follow(self, hand: PageInput, dt_ns: int, *, begins: bool) -> None:
        to_m = [hand.x * CAPABILITIES.half_width_m, hand.y * CAPABILITIES.half_height_m]
        to_m += [
            share * half * axis.lever_m
            for share, half, axis in zip(hand.more, self._halves, self._axes, strict=False)
        ]
        for axis, place_m in zip((self._x, self._y, *self._more), to_m, strict=False):
            if begins:
                axis.position, axis.speed = place_m, 0.0
            axis.advance(place_m, dt_ns)
        for more, followed in zip(self._axes, self._more, strict=True):
            more.position_m, more.speed_m_s = followed.position, followed.speed

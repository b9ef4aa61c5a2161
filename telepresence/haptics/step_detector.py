"""Detects steps of the received force: the stylus meets something.

The force is compared with a slowly following baseline, so constant pressure hides no step. Its
instant is that of the first sample of the rise. If samples carry the contact flag, a step begins
with the contact: a change during it, as of a hand that begins to retreat, is none.
"""

from collections import deque
from typing import NamedTuple

from kontur_av.clock import NS_PER_MS

#: A change of this size is a step (N). Chosen: a hundred counts of a sample.
THRESHOLD_N = 0.2
#: A smaller change is noise: ten counts of a sample.
_NOISE_N = 0.02
#: Time constant of the baseline.
_FOLLOW_NS = 50 * NS_PER_MS
#: A rise that takes longer is not a step.
_LONGEST_RISE_NS = 100 * NS_PER_MS
#: After a contact no other one counts for this long, because contacts bounce.
APART_NS = 100 * NS_PER_MS


class Step(NamedTuple):
    """The force stepped at `instant_ns`; `rise_n` is its change (N) at detection."""

    instant_ns: int
    rise_n: float


class StepDetector:
    """Takes every force sample in order, at 10 Hz or more. Fetch steps with `next_event`.

    It runs in the loop at 1 kHz: a sample without a step costs less than a microsecond. At most
    256 steps wait to be fetched; beyond that the oldest is dropped.
    """

    def __init__(self) -> None:
        self._base_x = 0.0
        self._base_y = 0.0
        self._last_ns: int | None = None
        self._rising_ns: int | None = None
        #: Since when samples have said contact.
        self._touched_ns: int | None = None
        #: The next step counts only after the force has come to rest.
        self._armed = True
        self._calm_ns: int | None = None
        self._events: deque[Step] = deque(maxlen=256)

    def handle_sample(
        self, now_ns: int, fx_n: float, fy_n: float = 0.0, contact: bool | None = None
    ) -> None:
        """Take the force (N) of a sample at `now_ns`; contact: None if the sample does not say."""
        last_ns = self._last_ns
        if last_ns is None:
            last_ns, self._base_x, self._base_y = now_ns, fx_n, fy_n
        self._last_ns = now_ns
        ahead_ns = now_ns - last_ns
        share = ahead_ns / _FOLLOW_NS if ahead_ns < _FOLLOW_NS else 1.0
        dx, dy = fx_n - self._base_x, fy_n - self._base_y
        change = dx * dx + dy * dy
        if not contact:
            self._touched_ns = None
        elif self._touched_ns is None:
            self._touched_ns = now_ns
        if contact is False or change < _NOISE_N * _NOISE_N:
            self._rising_ns = None
            self._base_x += dx * share
            self._base_y += dy * share
            if not self._armed:
                self._rest(now_ns)
            return
        self._calm_ns = None
        if not self._armed:
            # The baseline still follows: holding the pressure is not another step.
            self._base_x += dx * share
            self._base_y += dy * share
            if contact is None and change < THRESHOLD_N * THRESHOLD_N / 4:
                self._rest(now_ns)
            return
        if self._rising_ns is None:
            if self._touched_ns is not None and now_ns - self._touched_ns > _LONGEST_RISE_NS:
                self._armed = False
                return
            self._rising_ns = now_ns
        if change >= THRESHOLD_N * THRESHOLD_N:
            before = self._base_x * self._base_x + self._base_y * self._base_y
            if contact is None and fx_n * fx_n + fy_n * fy_n < before:
                # The contact ended.
                self._rising_ns, self._base_x, self._base_y = None, fx_n, fy_n
                return
            self._events.append(Step(self._rising_ns, change**0.5))
            self._armed, self._rising_ns = False, None
        elif now_ns - self._rising_ns > _LONGEST_RISE_NS:
            self._rising_ns = None
            self._base_x, self._base_y = fx_n, fy_n

    def next_event(self) -> Step | None:
        """The oldest step that was not fetched yet, or None."""
        return self._events.popleft() if self._events else None

    def _rest(self, now_ns: int) -> None:
        if self._calm_ns is None:
            self._calm_ns = now_ns
        elif now_ns - self._calm_ns >= APART_NS:
            self._armed, self._calm_ns = True, None

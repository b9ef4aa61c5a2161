"""Perceptual deadband: do not send samples whose difference the operator cannot feel.

A sample is left out while its value lies within a deadband around the value sent last. The
receiver holds that value. docs/haptics.md has the rules, and why it stays passive.

Sources: P. Hinterseer, S. Hirche, S. Chaudhuri, E. Steinbach, M. Buss, "Perception-based data
reduction and transmission of haptic data in telepresence and teleaction systems", IEEE Trans.
Signal Processing 56, 2008; J. Kammerl et al., "Perception-based data reduction for haptic
force-feedback signals using velocity-adaptive deadbands", Presence 19, 2010.
"""

from math import sqrt
from typing import Any

from kontur_av.clock import NS_PER_MS, NS_PER_S

#: Share of the force sent last.
FORCE_SHARE = 0.10
#: A smaller difference of forces is not felt, even around zero. Chosen: a third of what the
#: friction of a good handle hides.
FORCE_FLOOR_N = 0.1
#: A tenth of the smallest difference of length that fingers can tell, because the stiffness of a
#: contact multiplies it (1 mm: N. Durlach et al., "Manual discrimination and identification of
#: length by the finger-span method", Perception & Psychophysics 46, 1989).
POSITION_FLOOR_M = 0.1e-3
#: A moving hand may differ by the distance that it covers in this time (chosen).
POSITION_LAG_NS = NS_PER_MS
#: Energy granted since the last sample that may be held back. The peer cannot act on credit that
#: it has not received (docs/experiments/haptics.md). The robot spends more of it than the hand.
COMMAND_ENERGY_UJ = 50
FEEDBACK_ENERGY_UJ = 500
#: The peer counts as silent after 20 ms, so two samples in a row may still be lost.
LONGEST_PAUSE_NS = 6 * NS_PER_MS
#: After a burst of losses, no sample is left out for so long. A burst of losses spans as many
#: pauses as samples, so pauses would make the next one 6 times as long.
WHOLE_NS = 30 * NS_PER_S
#: A cycle that begins a little early still ends the pause.
_EARLY_NS = NS_PER_MS // 2
#: Shortest interval for a velocity: a late cycle is followed by one that is too soon.
_SHORTEST_NS = NS_PER_MS // 2

#: Indices of `acted` and `halted`, the same in `Command` and `Feedback`.
_ACTED, _HALTED = 6, 7


class Deadband:
    """Decides for each sample whether to send it. Call `handle_sample` once a cycle.

    share: band as a share of the value sent last.
    lag_ns: the band also grows by the distance moved in this time.
    floor: smallest band, in the value's unit.
    energy_uj: newly granted energy (µJ) that forces a sample out.

    samples: samples offered so far. left_out: how many of them were not sent.
    """

    def __init__(self, *, share: float, lag_ns: int, floor: float, energy_uj: int) -> None:
        self.left_out = 0
        self.samples = 0
        self._share = share
        self._lag_ns = lag_ns
        self._floor = floor
        self._energy_uj = energy_uj
        self._sent: Any = None
        self._due_ns = 0
        self._radius = 0.0
        self._holding = False
        self._acted = False
        #: Of each axis behind x and y.
        self._more_acted: list[bool] = []
        self._last_x = self._last_y = 0.0
        self._last_ns = 0
        self._whole_until_ns = 0

    def handle_gap(self, now_ns: int) -> None:
        """The peer has met a burst of losses: leave nothing out for `WHOLE_NS`."""
        self._whole_until_ns = now_ns + WHOLE_NS

    def rests(self, now_ns: int) -> bool:
        """Whether nothing may be sent in this cycle."""
        return False

    def handle_other(self, now_ns: int) -> None:
        """A greeting or an echo is sent in the place of a sample."""

    def handle_sample(self, value: Any, holding: bool, now_ns: int) -> Any:
        """Return the sample to send for `value` (a `Command` or a `Feedback`), or None.

        holding: the flag that goes with the sample. A change of `holding`, contact, state, mode,
        buttons, LED, or of a flag from `halted` on is always sent. `acted` is also set if the
        passivity controller acted during a sample that was left out.
        """
        self.samples += 1
        sent = self._sent
        x, y = value[0], value[1]
        room = self._radius
        if self._lag_ns:
            since_ns = now_ns - self._last_ns
            if since_ns < _SHORTEST_NS:
                since_ns = _SHORTEST_NS
            dx, dy = x - self._last_x, y - self._last_y
            room += sqrt(dx * dx + dy * dy) * self._lag_ns / since_ns
            self._last_x, self._last_y, self._last_ns = x, y, now_ns
        if sent is not None and self._whole_until_ns <= now_ns < self._due_ns:
            dx, dy = x - sent[0], y - sent[1]
            if (
                dx * dx + dy * dy < room * room
                and value[2] - sent[2] < self._energy_uj
                and value[3:_ACTED] == sent[3:_ACTED]
                and value[_HALTED:-1] == sent[_HALTED:-1]
                and holding == self._holding
                and (not value[-1] or self._more_rest(value[-1], sent[-1]))
            ):
                self.left_out += 1
                self._acted = self._acted or value[_ACTED]
                if value[-1]:
                    old = self._more_acted or [False] * len(value[-1])
                    self._more_acted = [a or one[2] for a, one in zip(old, value[-1], strict=True)]
                return None
        self._sent, self._holding = value, holding
        self._due_ns = now_ns + LONGEST_PAUSE_NS - _EARLY_NS
        radius = self._share * sqrt(x * x + y * y)
        self._radius = radius if radius > self._floor else self._floor
        if self._acted:
            self._acted = False
            value = value._replace(acted=True)
        if self._more_acted:
            acted, self._more_acted = self._more_acted, []
            axes = zip(acted, value[-1], strict=True)
            value = value._replace(more=tuple((*one[:2], a or one[2]) for a, one in axes))
        return value

    def _more_rest(self, axes: Any, sent: Any) -> bool:
        """Whether no axis behind x and y differs so that it would be felt."""
        return all(
            abs(here - there) < max(self._share * abs(there), self._floor)
            and energy_uj - sent_uj < self._energy_uj
            for (here, energy_uj, _), (there, sent_uj, _) in zip(axes, sent, strict=True)
        )


def command_deadband() -> Deadband:
    """Return the deadband for the joystick's positions (m)."""
    return Deadband(
        share=0.0, lag_ns=POSITION_LAG_NS, floor=POSITION_FLOOR_M, energy_uj=COMMAND_ENERGY_UJ
    )


def feedback_deadband() -> Deadband:
    """Return the deadband for the robot's forces (N)."""
    return Deadband(share=FORCE_SHARE, lag_ns=0, floor=FORCE_FLOOR_N, energy_uj=FEEDBACK_ENERGY_UJ)

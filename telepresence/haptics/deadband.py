"""Which samples need not be sent, because nobody would feel the difference: send on delta.

A sample is left out while what it says lies within a deadband around what was sent last; the
receiver holds that. The band grows with the value itself (Weber's law: P. Hinterseer, S. Hirche,
S. Chaudhuri, E. Steinbach, M. Buss, "Perception-based data reduction and transmission of haptic
data in telepresence and teleaction systems", IEEE Trans. Signal Processing 56, 2008: a band of
10 % of a force is not noticed). In two dimensions it is a disc: a force may also turn by what it
may grow. Of a position it grows with its velocity, because a fast hand is not a precise one (J.
Kammerl et al., "Perception-based data reduction for haptic force-feedback signals using
velocity-adaptive deadbands", Presence 19, 2010, for forces).

None of this can make the exchange active. A receiver that holds a value does what it does with a
sample that was lost: the observers see the energy that really flows at their own port, and credit
comes from the running totals of the samples that did come.
"""

from math import sqrt
from typing import Any

from kontur_av.clock import NS_PER_MS

#: Of the force that was sent last.
FORCE_SHARE = 0.10
#: Below this a difference of forces is not felt, however small the force (chosen: a third of what
#: the friction of a good handle hides).
FORCE_FLOOR_N = 0.1
#: A tenth of the smallest difference of length that fingers tell (1 mm: N. Durlach et al.,
#: "Manual discrimination and identification of length by the finger-span method", Perception &
#: Psychophysics 46, 1989), because it is multiplied by the stiffness of a contact.
POSITION_FLOOR_M = 0.1e-3
#: Where the hand was so long ago is where it is, for a hand that moves (chosen).
POSITION_LAG_NS = NS_PER_MS
#: Energy that is granted since the last sample is the peer's to spend, and what it lacks it can't
#: do (measured: docs/deadband.md). The robot spends more of it than the hand.
COMMAND_ENERGY_UJ = 50
FEEDBACK_ENERGY_UJ = 500
#: A peer is silent after 20 ms: so two samples in a row may be lost.
LONGEST_PAUSE_NS = 6 * NS_PER_MS
#: A cycle that begins a little early is still the last one of the pause.
_EARLY_NS = NS_PER_MS // 2
#: Velocity is taken over no shorter time: a cycle that came late is followed by one too soon.
_SHORTEST_NS = NS_PER_MS // 2

#: Places in both kinds of value.
_ACTED, _HALTED = 6, 7


class Deadband:
    """Says of each sample what is to be sent of it. A core: it is told the time.

    share: of the value last sent by which the next one may differ. lag_ns: it may also differ by
    what it moves in this time. floor: or by this, in the value's unit. energy_uj: so much that is
    granted is not kept back.

    Ask `handle_sample` once a cycle, and send what it gives. left_out: samples that were not
    sent, of `samples`.
    """

    def __init__(self, *, share: float, lag_ns: int, floor: float, energy_uj: int) -> None:
        self.left_out = 0
        self.samples = 0
        self._share = share
        self._lag_ns = lag_ns
        self._floor = floor
        self._energy_uj = energy_uj
        self._sent: Any = None
        self._sent_ns = 0
        self._radius = 0.0
        self._holding = False
        self._acted = False
        self._last_x = self._last_y = 0.0
        self._last_ns = 0

    def handle_sample(self, value: Any, holding: bool, now_ns: int) -> Any:
        """What is to be sent of `value`, a `Command` or a `Feedback` of `sample`; None if nothing.

        holding: the flag that goes with it. Where that, contact, state, mode, buttons, LED or a
        fault differ from what was sent last, it is sent. It says that the passivity controller
        acted also where that was at a sample that was left out.
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
        if sent is not None and now_ns - self._sent_ns < LONGEST_PAUSE_NS - _EARLY_NS:
            dx, dy = x - sent[0], y - sent[1]
            if (
                dx * dx + dy * dy < room * room
                and value[2] - sent[2] < self._energy_uj
                and value[3:_ACTED] == sent[3:_ACTED]
                and value[_HALTED] == sent[_HALTED]
                and holding == self._holding
            ):
                self.left_out += 1
                self._acted = self._acted or value[_ACTED]
                return None
        self._sent, self._sent_ns, self._holding = value, now_ns, holding
        radius = self._share * sqrt(x * x + y * y)
        self._radius = radius if radius > self._floor else self._floor
        if self._acted:
            self._acted = False
            return value._replace(acted=True)
        return value


def command_deadband() -> Deadband:
    """For the joystick's positions (m)."""
    return Deadband(
        share=0.0,
        lag_ns=POSITION_LAG_NS,
        floor=POSITION_FLOOR_M,
        energy_uj=COMMAND_ENERGY_UJ,
    )


def feedback_deadband() -> Deadband:
    """For the robot's forces (N)."""
    return Deadband(share=FORCE_SHARE, lag_ns=0, floor=FORCE_FLOOR_N, energy_uj=FEEDBACK_ENERGY_UJ)

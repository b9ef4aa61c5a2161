"""Without force feedback, samples go at a rate of their own and leave the rest to the pictures.

Commands have the rate of the setup, feedback `FEEDBACK_HZ`. Both have the layout of samples with
force (docs/wire-formats.md). A change of a flag does not wait for its turn.
"""

from typing import Any

from kontur_av.clock import NS_PER_MS, NS_PER_S

#: Rates of commands that a setup may choose from, and the rate of the robot's state.
LEAST_COMMAND_HZ, MOST_COMMAND_HZ, FEEDBACK_HZ = 50, 250, 50
#: Beside the samples there are greetings, echoes and changes of flags; room is kept for so many.
OTHERS_HZ = 15
#: No two samples, greetings or echoes are closer together, whatever changes.
_LEAST_GAP_NS = NS_PER_S // MOST_COMMAND_HZ
#: A newest sample is used for so many periods, so that the loss of one goes unnoticed.
_LASTS = 2.5
#: A cycle that begins a little early still is in time.
_EARLY_NS = NS_PER_MS // 2


def lasts_ns(rate_hz: int) -> int:
    """Return how long (ns) the newest sample is used that comes at `rate_hz`."""
    return round(_LASTS * NS_PER_S / rate_hz)


class SamplePace:
    """Decides for each sample whether to send it, as a `Deadband` does."""

    def __init__(self, rate_hz: int) -> None:
        self._period_ns = NS_PER_S // rate_hz
        self._due_ns = self._free_ns = -(1 << 62)
        #: All of the last sample but its numbers.
        self._flags: Any = None

    def handle_gap(self, now_ns: int) -> None:
        """The peer has met a burst of losses: nothing follows from it."""

    def rests(self, now_ns: int) -> bool:
        """Whether nothing may be sent in this cycle."""
        return now_ns < self._free_ns

    def handle_other(self, now_ns: int) -> None:
        """A greeting or an echo is sent in the place of a sample."""
        self._free_ns = now_ns + _LEAST_GAP_NS - _EARLY_NS

    def handle_sample(self, value: Any, holding: bool, now_ns: int) -> Any:
        """Return the sample to send for `value` (a `Command` or a `Feedback`), or None."""
        flags = (*value[3:-1], holding)
        due_ns = self._due_ns
        if now_ns < due_ns - _EARLY_NS and flags == self._flags:
            return None
        self._flags = flags
        # The grid goes on, unless this cycle is off it.
        on_grid = due_ns - _EARLY_NS <= now_ns < due_ns + self._period_ns
        self._due_ns = (due_ns if on_grid else now_ns) + self._period_ns
        self.handle_other(now_ns)
        return value

"""How long before its deadline a loop has to wake up."""

from kontur_av.clock import NS_PER_US

#: The margin's steps, and its bound. One in four wake-ups is later than it.
_SHRINK_NS = 100
_GROW_NS = 3 * _SHRINK_NS
_MOST_NS = 60 * NS_PER_US


class Margin:
    """How long before a deadline to wake up, so that most times it has not passed by then.

    A core. It learns how late wake-ups are, and follows what three of four of them stay below: the
    stochastic approximation of a quantile (Robbins and Monro 1951), one comparison a wake-up. A
    larger share would cost more waiting than it gains: what comes later is little later.

    ns: the margin, at most 60 µs: whoever is later than that has been held up, not woken.
    """

    def __init__(self) -> None:
        self.ns = 0

    def handle_wakeup(self, late_ns: int) -> None:
        """It was ready `late_ns` after the instant for which it had asked to be woken."""
        if late_ns > self.ns:
            self.ns = min(self.ns + _GROW_NS, _MOST_NS)
        else:
            self.ns = max(self.ns - _SHRINK_NS, 0)

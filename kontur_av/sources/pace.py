"""Absolute deadlines at a fixed rate; missed ones are skipped, never made up in a burst."""

from fractions import Fraction

from kontur_av.clock import NS_PER_S


class Pace:
    """The instants k / rate (+ phase) of a clock, in order.

    They derive from the clock's zero, so two cameras with the same rate and phase capture at the
    same instants, as if genlocked, although separate processes run them.

    rate_hz: instants a second.
    phase: offset as a share of the period, 0 <= phase < 1.
    patience: how many periods late a reader may be before instants are skipped.
    skipped: instants skipped so far.
    """

    def __init__(
        self, rate_hz: Fraction | int, now_ns: int, *, phase: float = 0.0, patience: int = 1
    ) -> None:
        # A fraction as two integers: exact, and no Fraction object for each picture.
        self._period_ns, self._parts = (Fraction(NS_PER_S) / Fraction(rate_hz)).as_integer_ratio()
        self._phase_ns = int(self._period_ns * Fraction(phase) / self._parts)
        self._patience_ns = self._period_ns * patience // self._parts
        self._index = self._last_before(now_ns) + 1
        self.skipped = 0

    def due_ns(self, now_ns: int) -> int:
        """Return the next instant, or the latest past one if the reader is too late."""
        due_ns = self._instant(self._index)
        if now_ns - due_ns > self._patience_ns:
            latest = self._last_before(now_ns)
            self.skipped += latest - self._index
            self._index = latest
            due_ns = self._instant(latest)
        return due_ns

    def handle_taken(self) -> None:
        self._index += 1

    def _instant(self, index: int) -> int:
        return index * self._period_ns // self._parts + self._phase_ns

    def _last_before(self, now_ns: int) -> int:
        index = (now_ns - self._phase_ns) * self._parts // self._period_ns
        # _instant rounds down, so the next instant may already lie at now_ns.
        return index + 1 if self._instant(index + 1) <= now_ns else index

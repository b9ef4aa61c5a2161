"""When the next cycle is due: absolute deadlines that neither drift nor catch up."""

from kontur_av.clock import NS_PER_MS


class PeriodicSchedule:
    """Deadlines at `start_ns + k * period_ns`; a missed cycle is skipped and counted.

    next_deadline_ns: when to wake next.
    cycles: cycles done. slips: cycles skipped.
    advance_ns: time covered by the last wake-up: one period, or more after slips.
    """

    def __init__(self, *, start_ns: int, period_ns: int = NS_PER_MS) -> None:
        if period_ns <= 0:
            raise ValueError("a period is at least 1 ns")
        self.period_ns = period_ns
        self.next_deadline_ns = start_ns
        self.advance_ns = period_ns
        self.cycles = 0
        self.slips = 0

    def handle_wakeup(self, now_ns: int) -> int:
        """Return how late this wake-up is (ns); negative if it is too early and nothing changed.

        A wake-up that is a period or more late does one cycle only. The next deadline is the first
        one ahead, because a burst of catching up would send more than the radio can carry.
        """
        lateness_ns = now_ns - self.next_deadline_ns
        if lateness_ns < 0:
            return lateness_ns
        advance_ns = self.period_ns
        if lateness_ns >= advance_ns:
            skipped = lateness_ns // advance_ns
            self.slips += skipped
            advance_ns *= skipped + 1
        self.advance_ns = advance_ns
        self.next_deadline_ns += advance_ns
        self.cycles += 1
        return lateness_ns

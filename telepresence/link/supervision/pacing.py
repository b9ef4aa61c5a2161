"""When the next supervision message goes out: each takes a slot's packets their place."""

from telepresence.link.supervision.configuration import SupervisionTiming


class MessagePacing:
    """At once on a change, fast while it may not be known yet, then slow. due_ns: the next."""

    def __init__(self, timing: SupervisionTiming, now_ns: int) -> None:
        self.due_ns = now_ns
        self._timing = timing
        #: What the last message said; of the rest of it (held contexts) apart.
        self._told: tuple[int, ...] = ()
        self._told_rest: tuple[int, ...] = ()
        self._now: tuple[int, ...] = ()
        self._changed_ns = now_ns
        self._sent_ns = now_ns - timing.slow_ns

    def handle_content(
        self,
        content: tuple[int, ...],
        rest: tuple[int, ...],
        now_ns: int,
        *,
        heard: bool,
        settled: bool,
    ) -> None:
        """What a message would say now. heard: the peer hears. settled: it needs nothing more."""
        timing = self._timing
        if content != self._now:
            self._now, self._changed_ns = content, now_ns
        if content != self._told:
            wait_ns = timing.spacing_ns
        elif rest != self._told_rest:
            wait_ns = timing.fast_ns
        elif settled:
            wait_ns = timing.slow_ns
        elif now_ns - self._changed_ns < timing.settle_ns:
            wait_ns = timing.fast_ns
        else:
            wait_ns = timing.slow_ns if heard else timing.search_ns
        self.due_ns = self._sent_ns + wait_ns

    def handle_sent(self, content: tuple[int, ...], rest: tuple[int, ...], now_ns: int) -> None:
        """A message with this has been sent."""
        self._told, self._told_rest, self._sent_ns = content, rest, now_ns

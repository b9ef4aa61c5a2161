"""When to send the next supervision message; each one takes capacity from packets."""

from telepresence.link.supervision.configuration import SupervisionTiming


class MessagePacing:
    """Messages at once on a change, fast until the peer may know it, then slowly.

    due_ns: when the next message is due. earliest_ns: none may be sent before, whatever its kind.
    """

    def __init__(self, timing: SupervisionTiming, now_ns: int) -> None:
        self.due_ns = self.earliest_ns = now_ns
        self._timing = timing
        #: What the last message contained; the rest (contexts held) separately.
        self._sent: tuple[int, ...] = ()
        self._sent_rest: tuple[int, ...] = ()
        self._content: tuple[int, ...] = ()
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
        """Update the next message. heard: the peer hears. settled: it needs nothing more."""
        timing = self._timing
        if content != self._content:
            self._content, self._changed_ns = content, now_ns
        if content != self._sent:
            wait_ns = timing.spacing_ns
        elif rest != self._sent_rest:
            wait_ns = timing.fast_ns
        elif settled:
            wait_ns = timing.slow_ns
        elif now_ns - self._changed_ns < timing.settle_ns:
            wait_ns = timing.fast_ns
        else:
            wait_ns = timing.slow_ns if heard else timing.search_ns
        self.due_ns = max(self._sent_ns + wait_ns, self.earliest_ns)

    def handle_sent(self, content: tuple[int, ...], rest: tuple[int, ...], now_ns: int) -> None:
        """A message with this content was sent."""
        self._sent, self._sent_rest, self._sent_ns = content, rest, now_ns
        self.handle_extra(now_ns)

    def handle_extra(self, now_ns: int) -> None:
        """A message was sent that does not take the place of a regular one."""
        self.earliest_ns = now_ns + self._timing.spacing_ns

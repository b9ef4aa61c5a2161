"""A topic that is only written while it has readers."""

from kontur_av.clock import NS_PER_MS

_ASK_NS = 100 * NS_PER_MS


class WatchedTopic:
    """Whenever `asks` returns True, look for readers and call `handle_watched`.

    watched: the topic had readers when they were last looked for.
    """

    def __init__(self) -> None:
        self.watched = False
        self._ask_ns = 0

    def asks(self, now_ns: int) -> bool:
        """Whether it is time to look for readers: once in 100 ms."""
        if now_ns < self._ask_ns:
            return False
        self._ask_ns = now_ns + _ASK_NS
        return True

    def handle_watched(self, watched: bool) -> None:
        self.watched = watched

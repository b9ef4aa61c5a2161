"""How many connections a server keeps, and for how long one may go without a token. A core.

Whoever has not shown a token is a stranger. A stranger's connection is closed after `STRANGER_NS`,
and the oldest of them makes room for a new one. So idle connections keep nobody out who has a
token, and take few of the process's descriptors.
"""

from kontur_av.clock import NS_PER_S

#: Connections in all; of strangers in all, and from one address.
MOST_CONNECTIONS, MOST_STRANGERS, MOST_OF_ADDRESS = 256, 64, 32
#: A stranger's longest time, and the longest that TLS may take to agree on keys.
STRANGER_NS = 10 * NS_PER_S
HANDSHAKE_S = 5.0


class Doorway:
    """Connections by numbers that the caller chooses. Close those that the methods return.

    closed: connections that were closed so far, to make room or for their time.
    """

    def __init__(self) -> None:
        self.closed = 0
        #: By number, oldest first: address, and when it came.
        self._strangers: dict[int, tuple[str, int]] = {}
        self._known: set[int] = set()

    def __len__(self) -> int:
        return len(self._strangers) + len(self._known)

    def handle_accepted(self, number: int, address: str, now_ns: int) -> list[int]:
        """A connection has come; return those to close, which may be itself."""
        self._strangers[number] = (address, now_ns)
        closing = []
        same = [one for one, (host, _) in self._strangers.items() if host == address]
        if len(same) > MOST_OF_ADDRESS:
            closing.append(same[0])
        elif len(self._strangers) > MOST_STRANGERS or len(self) > MOST_CONNECTIONS:
            closing.append(next(iter(self._strangers)))
        return self._close(closing)

    def handle_known(self, number: int) -> None:
        if self._strangers.pop(number, None) is not None:
            self._known.add(number)

    def handle_closed(self, number: int) -> None:
        self._strangers.pop(number, None)
        self._known.discard(number)

    def handle_time(self, now_ns: int) -> list[int]:
        """Return the connections of strangers whose time is over."""
        return self._close(
            [one for one, (_, since) in self._strangers.items() if now_ns - since >= STRANGER_NS]
        )

    def _close(self, closing: list[int]) -> list[int]:
        for number in closing:
            del self._strangers[number]
        self.closed += len(closing)
        return closing

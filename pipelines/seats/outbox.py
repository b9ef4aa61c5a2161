"""Requests to the TM/TC end of a segment: repeated until that has answered once."""

from collections import OrderedDict
from typing import Generic, TypeVar

from kontur_av.clock import NS_PER_S

AGAIN_NS = NS_PER_S
_TRIES = 5
_Request = TypeVar("_Request")


class Outbox(Generic[_Request]):
    """By number: what was not answered yet. A core.

    Send what `poll_transmit` returns. A request that nobody answered after five sendings, one a
    second, comes out of `next_event`. The end takes a repetition for what it is.
    """

    def __init__(self) -> None:
        #: By number: the request, how often it was sent, and when it is due next.
        self._waiting: OrderedDict[int, tuple[_Request, int, int]] = OrderedDict()

    def put(self, number: int, request: _Request, now_ns: int) -> None:
        """Send this."""
        self._waiting[number] = request, 0, now_ns

    def handle_answer(self, number: int) -> None:
        """The end has it."""
        self._waiting.pop(number, None)

    def poll_transmit(self, now_ns: int) -> _Request | None:
        """Return a request that is due, or None."""
        for number, (request, tries, due_ns) in self._waiting.items():
            if due_ns <= now_ns and tries < _TRIES:
                self._waiting[number] = request, tries + 1, now_ns + AGAIN_NS
                return request
        return None

    def next_event(self, now_ns: int) -> int | None:
        """Return the number of a request that is given up, or None."""
        for number, (_, tries, due_ns) in self._waiting.items():
            if tries >= _TRIES and due_ns <= now_ns:
                del self._waiting[number]
                return number
        return None

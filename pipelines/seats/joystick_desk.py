"""Commands to the joystick: one after the other, each with its answer."""

from collections import deque
from typing import NamedTuple

from kontur_av.clock import NS_PER_S
from pipelines.hand.hand_topics import HandRequest, JoystickStatus
from telepresence.haptics.device.states import JoystickEvent

_MOST_WAITING = 8
#: The joystick answers within 100 ms; it may be restarting.
_PATIENCE_NS = NS_PER_S


class Answered(NamedTuple):
    """What became of the request of a page. error: "" if it was carried out."""

    page: int
    request: int
    error: str


class _Waiting(NamedTuple):
    page: int
    request: int
    event: JoystickEvent


class JoystickDesk:
    """Passes commands on by their numbers. A core.

    Drain `poll_transmit` and `next_event` after each `handle_`. The joystick tells only the answer
    to its newest command, so there is one under way at a time.

    first_number: above those of an earlier life of this process.
    """

    def __init__(self, first_number: int) -> None:
        self._number = first_number
        self._waiting: deque[_Waiting] = deque()
        self._open: _Waiting | None = None
        self._until_ns = 0
        self._events: deque[Answered] = deque()

    def handle_request(self, page: int, request: int, event: JoystickEvent) -> None:
        """A page asks for something."""
        if len(self._waiting) >= _MOST_WAITING:
            self._events.append(Answered(page, request, "too many commands wait"))
        else:
            self._waiting.append(_Waiting(page, request, event))

    def handle_status(self, status: JoystickStatus) -> None:
        """The joystick has told its state."""
        if self._open is not None and status.answered == self._number:
            self._answer(status.refusal)

    def handle_timeout(self, now_ns: int) -> None:
        """Time has passed."""
        if self._open is not None and now_ns >= self._until_ns:
            self._answer("the joystick does not answer")

    def poll_transmit(self, now_ns: int) -> HandRequest | None:
        """Return the next command for the joystick, or None."""
        if self._open is not None or not self._waiting:
            return None
        self._open = self._waiting.popleft()
        self._number += 1
        self._until_ns = now_ns + _PATIENCE_NS
        return HandRequest(self._number, self._open.event)

    def next_event(self) -> Answered | None:
        """Return the next answer for a page, or None."""
        return self._events.popleft() if self._events else None

    def _answer(self, error: str) -> None:
        assert self._open is not None
        self._events.append(Answered(self._open.page, self._open.request, error))
        self._open = None

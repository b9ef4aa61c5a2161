"""The handle at a seat: who holds it, whose inputs count, and commands to the joystick. Cores."""

from collections import deque
from typing import NamedTuple

from kontur_av.clock import NS_PER_S
from pipelines.hand.hand_topics import HandRequest, JoystickStatus
from pipelines.seats.texts import Answered
from telepresence.haptics.device.page import PageInput
from telepresence.haptics.device.states import JoystickEvent


class HandleState(NamedTuple):
    """holder: number of the page that holds the handle. wanted_by: of the page that asks for it."""

    holder: int | None = None
    wanted_by: int | None = None


class HandleOwnership:
    """The pages of a seat by their numbers, and which of them holds the handle.

    Each `handle_` returns "" or one line that says why it was refused. A page that may only watch
    is never joined, so all that it asks is refused. Inputs count only while `may_move` is true.

    state: for the display. `next_event` returns it after each change.
    """

    def __init__(self) -> None:
        self.state = HandleState()
        self._pages: dict[int, str] = {}
        self._shown = self.state

    def handle_joined(self, page: int, name: str) -> None:
        """A page has come that may hold the handle. name: who sits there, for others' refusals."""
        self._pages[page] = name

    def name(self, page: int | None) -> str:
        """Return who sits at a page; "" of no page, or of one that is unknown here."""
        return "" if page is None else self._pages.get(page, "")

    def handle_gone(self, page: int) -> None:
        """A page is gone; what it held is free at once."""
        self._pages.pop(page, None)
        holder, wanted_by = self.state
        if page == holder:
            self.state = HandleState()
        elif page == wanted_by:
            self.state = HandleState(holder)

    def handle_take(self, page: int) -> str:
        """The page takes the handle, if it is free."""
        if page not in self._pages:
            return "take: this page may watch only"
        holder = self.state.holder
        if holder == page:
            return ""
        if holder is not None:
            return f"take: {self.name(holder)} has the handle: ask for it"
        self.state = HandleState(page)
        return ""

    def handle_ask(self, page: int) -> str:
        """The page asks the holder for the handle; it takes a free one."""
        holder, wanted_by = self.state
        if page not in self._pages or holder is None or holder == page:
            return self.handle_take(page)
        if wanted_by not in (None, page):
            return f"ask: {self.name(wanted_by)} has asked before"
        self.state = HandleState(holder, page)
        return ""

    def handle_give(self, page: int) -> str:
        """The holder gives the handle to the page that asked for it, or frees it."""
        if page != self.state.holder:
            return "give: this page does not hold the handle"
        self.state = HandleState(self.state.wanted_by)
        return ""

    def handle_refuse(self, page: int) -> str:
        """The holder keeps the handle, and the page that asked stops asking."""
        if page != self.state.holder:
            return "refuse: this page does not hold the handle"
        self.state = HandleState(page)
        return ""

    def may_move(self, page: int) -> bool:
        return page == self.state.holder

    def next_event(self) -> HandleState | None:
        """Return the state if it has changed since the last call, or None."""
        if self._shown == self.state:
            return None
        self._shown = self.state
        return self.state


_SEQUENCES = 1 << 32


class HandGate:
    """Passes the inputs of the page that holds the handle, with numbers of its own.

    Call `poll_release` after each change of the holder: the handle is let go when it changes hands.
    """

    def __init__(self, ownership: HandleOwnership) -> None:
        self._ownership = ownership
        self._holder: int | None = None
        self._held = False
        self._newest: int | None = None
        self._sequence = 0

    def handle_input(self, page: int, hand: PageInput) -> PageInput | None:
        """Return what to tell the joystick, or None.

        None: the page does not hold the handle, or the input is not newer than the one before, or
        its place is not from -1 to 1.
        """
        if not self._ownership.may_move(page):
            return None
        if page != self._holder:
            released = self.poll_release(hand.received_ns)
            self._holder, self._newest = page, None
            if released is not None:
                # The next hand begins where this one lets go.
                return released
        newest = self._newest
        ahead = 1 if newest is None else (hand.sequence - newest) % _SEQUENCES
        # A NaN fails the comparisons, too.
        if not (0 < ahead < _SEQUENCES // 2 and -1.0 <= hand.x <= 1.0 and -1.0 <= hand.y <= 1.0):
            return None
        self._newest = hand.sequence
        self._held = hand.dead_man
        return self._numbered(hand)

    def poll_release(self, now_ns: int) -> PageInput | None:
        """Return the input that lets the handle go, once, if its hand is no longer the holder's."""
        if not self._held or (self._holder is not None and self._ownership.may_move(self._holder)):
            return None
        self._held = False
        self._holder = None
        return self._numbered(PageInput(False, 0.0, 0.0, received_ns=now_ns))

    def _numbered(self, hand: PageInput) -> PageInput:
        self._sequence = (self._sequence + 1) % _SEQUENCES
        return hand._replace(sequence=self._sequence)


_MOST_WAITING = 8
#: The joystick answers within 100 ms; it may be restarting.
_PATIENCE_NS = NS_PER_S


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
        if len(self._waiting) >= _MOST_WAITING:
            self._events.append(Answered(page, request, "too many commands wait"))
        else:
            self._waiting.append(_Waiting(page, request, event))

    def handle_status(self, status: JoystickStatus) -> None:
        if self._open is not None and status.answered == self._number:
            self._answer(status.refusal)

    def handle_timeout(self, now_ns: int) -> None:
        if self._open is not None and now_ns >= self._until_ns:
            self._answer("the joystick does not answer")

    def poll_transmit(self, now_ns: int) -> HandRequest | None:
        if self._open is not None or not self._waiting:
            return None
        self._open = self._waiting.popleft()
        self._number += 1
        self._until_ns = now_ns + _PATIENCE_NS
        return HandRequest(self._number, self._open.event)

    def next_event(self) -> Answered | None:
        return self._events.popleft() if self._events else None

    def _answer(self, error: str) -> None:
        assert self._open is not None
        self._events.append(Answered(self._open.page, self._open.request, error))
        self._open = None

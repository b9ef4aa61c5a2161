"""Which page of a seat holds the handle, a camera or a microphone, and what comes of it. Cores."""

from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple

from kontur_av.clock import NS_PER_MS, NS_PER_S, NS_PER_US
from kontur_av.errors import ProtocolError
from kontur_av.media import CaptureStamp
from pipelines.hand.hand_topics import HandRequest, JoystickStatus
from pipelines.seats.open_page import MessageRate, PageTalker
from pipelines.seats.plan import SeatInput, SeatPlan
from pipelines.seats.texts import Answered, AnswerText, pack_text, parse_media_request
from pipelines.session.access import VIEWER_WORDS, Role, place_name
from pipelines.session.page_messages import OwnPicture, Ping, pack_pong, parse_media_message
from telepresence.haptics.device.page import PageInput
from telepresence.haptics.device.states import JoystickEvent


class HandleState(NamedTuple):
    """holder: number of the page that holds the handle. wanted_by: of the page that asks for it."""

    holder: int | None = None
    wanted_by: int | None = None


class HandleAuthority:
    """The pages of a seat by their numbers, and which of them holds the handle.

    Each `handle_` returns "" or one line that says why it was refused. A page that may only watch
    is never joined, so all that it asks is refused. Inputs count only while `may_move` is true.

    state: for the display. `next_event` returns it after each change. policy: number of the one
    that has joined, from which a person takes the handle without asking.
    """

    def __init__(self) -> None:
        self.state = HandleState()
        self._pages: dict[int, str] = {}
        self.policy: int | None = None
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
        if holder not in (None, self.policy):
            return f"take: {self.name(holder)} has the handle: ask for it"
        self.state = HandleState(page)
        return ""

    def handle_ask(self, page: int) -> str:
        """The page asks the holder for the handle; it takes a free one."""
        holder, wanted_by = self.state
        if page not in self._pages or holder in (None, page, self.policy):
            return self.handle_take(page)
        if wanted_by not in (None, page):
            return f"ask: {self.name(wanted_by)} has asked before"
        self.state = HandleState(holder, page)
        return ""

    def handle_give(self, page: int | None) -> str:
        """The holder gives the handle to the page that asked for it, or frees it."""
        if page is None or page != self.state.holder:
            return "give: this page does not hold the handle"
        self.state = HandleState(self.state.wanted_by)
        return ""

    def handle_let(self, page: int | None) -> str:
        """A person hands over to the policy; page: where, None: by a telecommand."""
        holder = self.state.holder
        if holder not in (None, page, self.policy):
            return f"policy: {self.name(holder)} has the handle: ask for it"
        self.state = HandleState(self.policy)
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

    def __init__(self, ownership: HandleAuthority) -> None:
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
_TIMEOUT_NS = NS_PER_S


class _Waiting(NamedTuple):
    page: int
    request: int
    event: JoystickEvent


class JoystickClient:
    """Passes commands on by their numbers. A core.

    Drain `poll_transmit` and `next_event` after each `handle_`. The joystick tells only the answer
    to its newest command, so there is one under way at a time.

    first_number: above those of an earlier start of this process.
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
        self._until_ns = now_ns + _TIMEOUT_NS
        return HandRequest(self._number, self._open.event)

    def next_event(self) -> Answered | None:
        return self._events.popleft() if self._events else None

    def _answer(self, error: str) -> None:
        assert self._open is not None
        self._events.append(Answered(self._open.page, self._open.request, error))
        self._open = None


#: Pings from which the offset is taken: 16 s of them, so that the clocks may drift apart.
_KEPT = 16
#: What a page captured is never older, and never from the future.
_OLDEST_NS = 500 * NS_PER_MS


class PageClock:
    """Maps the instants of one page to the session's clock, by the ping that took least time.

    So every instant comes out later by the least time that a message takes from the page: less than
    1 ms on one machine. A page cannot claim more than 500 ms.
    """

    def __init__(self) -> None:
        self._offsets_ns: deque[int] = deque(maxlen=_KEPT)

    def handle_ping(self, page_ms: float, now_ns: int) -> None:
        self._offsets_ns.append(now_ns - _ns(page_ms))

    def instant_ns(self, page_ms: float, now_ns: int) -> int:
        """Return `page_ms` on the session's clock, from 500 ms ago to now."""
        if not self._offsets_ns:
            return now_ns
        instant_ns = _ns(page_ms) + min(self._offsets_ns)
        return min(max(instant_ns, now_ns - _OLDEST_NS), now_ns)


def _ns(page_ms: float) -> int:
    return int(page_ms * NS_PER_MS)


_SOUND_HZ, _SOUND_BURST = 60, 50


class Given(NamedTuple):
    """A picture or a block of sound for an input. size: of the picture; None: it is sound."""

    input: SeatInput
    data: memoryview
    stamp: CaptureStamp


@dataclass
class _Link(PageTalker):
    clock: PageClock = field(default_factory=PageClock)
    media: dict[int, MessageRate] = field(default_factory=dict)


class OwnInputs:
    """The sockets on which pages send what they film and say. A core.

    Each input belongs to at most one socket, and is free again when that is gone. Raises
    ProtocolError where a socket is to be closed.
    """

    def __init__(self, plan: SeatPlan) -> None:
        self._inputs = {each.index: each for each in plan.inputs}
        self._sizes, self._segment = plan.sizes, plan.segment
        self._links: dict[int, _Link] = {}
        self._owners: dict[int, int] = {}
        self._counts: dict[int, int] = dict.fromkeys(self._inputs, 0)

    @property
    def owners(self) -> dict[str, int | None]:
        """By input: the number of the socket that has taken it over."""
        return {each.name: self._owners.get(index) for index, each in self._inputs.items()}

    def handle_opened(self, link: int, role: Role) -> None:
        self._links[link] = _Link(role)

    def handle_closed(self, link: int) -> None:
        """A socket is gone, and gives back what it had."""
        del self._links[link]
        self._owners = {index: owner for index, owner in self._owners.items() if owner != link}

    def handle_text(self, link: int, text: str, now_ns: int) -> str:
        one = self._links[link]
        if not one.texts.handle_message(now_ns):
            raise ProtocolError("too many requests")
        request = parse_media_request(text)
        if one.role is Role.VIEWER:
            error = VIEWER_WORDS
        else:
            error = self._settle(link, request.name, on=request.on)
        return pack_text(AnswerText(request=request.request, ok=not error, error=error))

    def handle_message(self, link: int, data: bytes, now_ns: int) -> bytes | Given | None:
        """Return the answer to a ping, or what is given for an input; None for what is refused."""
        one = self._links[link]
        message = parse_media_message(data, self._sizes)
        if isinstance(message, Ping):
            if not one.pings.handle_message(now_ns):
                raise ProtocolError("too many pings")
            one.clock.handle_ping(message.page_ms, now_ns)
            return pack_pong(message.page_ms, now_ns // NS_PER_US)
        given = self._inputs[message.input]
        if given.index not in one.media:
            sound = given.size is None
            hz = _SOUND_HZ if sound else given.fps * 3 // 2 + 1
            one.media[given.index] = MessageRate(hz, _SOUND_BURST if sound else given.fps)
        if not one.media[given.index].handle_message(now_ns):
            raise ProtocolError(f"too much for {given.name}")
        if self._owners.get(given.index) != link:
            return None
        if isinstance(message, OwnPicture):
            number = self._counts[given.index] = self._counts[given.index] + 1
        else:
            number = message.sequence
        capture_ns = one.clock.instant_ns(message.page_ms, now_ns)
        return Given(given, message.data, CaptureStamp(capture_ns, number, given.name))

    def _settle(self, link: int, name: str, *, on: bool) -> str:
        """Take an input over, or give it back; return why not, or ""."""
        index = next((index for index, one in self._inputs.items() if one.name == name), None)
        if on:
            if index is None:
                return f"{name}: no page can give this input here"
            owner = self._owners.setdefault(index, link)
            who = place_name(self._links[owner].role, self._segment)
            return "" if owner == link else f"{name}: {who} has it at another page"
        if index is None or self._owners.get(index) != link:
            return f"{name}: this page does not have it"
        del self._owners[index]
        return ""

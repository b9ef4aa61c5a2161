"""The cameras and microphones of pages: who has taken which input over, and what they give."""

from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple

from kontur_av.clock import NS_PER_MS, NS_PER_US
from kontur_av.errors import ProtocolError
from kontur_av.media import CaptureStamp
from pipelines.seats.open_page import MessageRate, PageTalker
from pipelines.seats.plan import SeatInput, SeatPlan
from pipelines.seats.texts import AnswerText, pack_text, parse_media_request
from pipelines.session.access import VIEWER_WORDS, Role, place_name
from pipelines.session.messages import OwnPicture, Ping, pack_pong, parse_media_message

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

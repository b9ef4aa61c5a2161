"""Telecommands and the chat of a seat's pages, each with what became of it. A core."""

from collections import deque
from itertools import count

from msgspec.structs import replace

from kontur_av.clock import NS_PER_S, NS_PER_US
from pipelines.mission import tmtc_messages
from pipelines.mission.choosing import CAMERA, SELECT
from pipelines.seats import texts
from telepresence.tmtc.k2aci import MAX_CHAT_OCTETS, Chat, ChatRole
from telepresence.tmtc.retransmission import Retransmission

AGAIN_NS = NS_PER_S
#: A request that its end has not answered after five sendings, one a second, is given up.
_TIMEOUT_NS = 5 * AGAIN_NS
#: What a line takes from its updates.
_TOLD = ("stage", "done", "ok", "verified", "reason", "round_trip_ms", "tries")
_MOST_LINES = 60
_MOST_OPEN = 8
_SILENT = "telecommands of this end do not answer"


class CommandClient:
    """Passes telecommands on, and keeps what became of them. A core.

    After each `handle_`, send `poll_transmit`'s requests and drain `next_event`.

    unverified: telecommands since the last one that the other end verified.
    """

    def __init__(self, client: str) -> None:
        self.unverified = 0
        self._client = client
        self._lines: deque[texts.CommandLine] = deque(maxlen=_MOST_LINES)
        self._numbers = count(1)
        self._outbox: Retransmission[tmtc_messages.SendCommand] = Retransmission(
            timeout_ns=AGAIN_NS, most=_MOST_OPEN, give_up_ns=_TIMEOUT_NS, longest=1
        )
        #: By number: page and request that wait for the end.
        self._open: dict[int, tuple[int, int]] = {}
        #: By number: the camera that it selects.
        self._selects: dict[int, str] = {}
        self._events: deque[texts.Answered] = deque()

    @property
    def text(self) -> texts.CommandsText:
        """All telecommands that are kept, the oldest first."""
        return texts.CommandsText(commands=tuple(self._lines))

    def handle_request(self, page: int, asked: texts.CommandRequest, who: str, now_ns: int) -> None:
        """A page asks for a telecommand that it may give. who: its person."""
        if len(self._open) >= _MOST_OPEN:
            refused = texts.Answered(page, asked.request, "too many telecommands are open", 0.0)
            self._events.append(refused)
            return
        number = next(self._numbers)
        command = tmtc_messages.SendCommand(
            self._client, number, asked.application, asked.verb, asked.name, asked.arguments
        )
        self._outbox.handle_put(command, now_ns, number)
        self._open[number] = page, asked.request
        if (asked.application, asked.name) == (CAMERA, SELECT) and asked.arguments:
            self._selects[number] = str(asked.arguments[0])
        given = (asked.application, asked.name or asked.verb, *asked.arguments)
        words, at_us = " ".join(map(str, given)), now_ns // NS_PER_US
        line = texts.CommandLine(number=number, at_us=at_us, who=who, words=words, stage="sent")
        self._lines.append(line)

    def handle_update(self, update: tmtc_messages.CommandUpdate) -> bool:
        """What became of a telecommand; False if it is of another process."""
        if update.client != self._client:
            return False
        self._outbox.pop(update.id)
        self._settle(update)
        return True

    def poll_transmit(self, now_ns: int) -> tmtc_messages.SendCommand | None:
        while (number := self._outbox.next_given_up(now_ns)) is not None:
            self._outbox.pop(number)
            given_up = tmtc_messages.CommandUpdate(
                self._client, number, "", "refused", done=True, reason=_SILENT
            )
            self._settle(given_up)
        due = self._outbox.poll_transmit(now_ns)
        return None if due is None else due[1].item

    def next_event(self) -> texts.Answered | None:
        return self._events.popleft() if self._events else None

    def _settle(self, update: tmtc_messages.CommandUpdate) -> None:
        for index, line in enumerate(self._lines):
            if line.number == update.id and not line.done:
                told = {name: getattr(update, name) for name in _TOLD}
                self._lines[index] = replace(line, **told)
        if not update.done:
            return
        if update.verified or update.ok:
            self.unverified = 0
        elif update.stage == "failed":
            self.unverified += 1
        opened = self._open.pop(update.id, None)
        if opened is not None:
            camera = self._selects.pop(update.id, "")
            error = "" if update.ok else update.reason or update.stage
            if camera and error:
                camera, error = "", tmtc_messages.selection_error(f"select {camera}", update)
            self._events.append(texts.Answered(*opened, error, update.round_trip_ms, camera))


_MOST_CHAT_LINES = 100
_MOST_WAITING = 16
_CHAT_SILENT = "telecommands and telemetry of this end do not answer"


class ChatLog:
    """Lines in the order in which this end knew them. A core.

    A line of this end waits until the other end has acknowledged it. The people of one end see
    each other's lines at once. client: new in each start of the process.
    """

    def __init__(self, client: str) -> None:
        self._client = client
        self._numbers = count(1)
        self._lines: deque[texts.ChatLine] = deque(maxlen=_MOST_CHAT_LINES)
        self._outbox: Retransmission[tmtc_messages.SendK2aci] = Retransmission(
            timeout_ns=AGAIN_NS, most=_MOST_WAITING, give_up_ns=_TIMEOUT_NS, longest=1
        )

    @property
    def text(self) -> texts.ChatText:
        return texts.ChatText(lines=tuple(self._lines))

    def handle_said(self, sender: ChatRole, text: str, now_ns: int) -> str:
        """A person of this end has written a line; return why it is not sent, or ""."""
        text = " ".join(text.split())
        octets = len(text.encode())
        if not text or not text.isprintable():
            return "write one line of text"
        if octets > MAX_CHAT_OCTETS:
            return f"a line has at most {MAX_CHAT_OCTETS} bytes, this one {octets}: shorten it"
        if sum(line.state == "waiting" for line in self._lines) >= _MOST_WAITING:
            return f"{_MOST_WAITING} lines wait for the other end"
        number = self._add(sender, text, "waiting", now_ns)
        fields = {"sender": str(sender), "text": text}
        request = tmtc_messages.SendK2aci(self._client, number, "Chat", {**fields})
        self._outbox.handle_put(request, now_ns, number)
        return ""

    def handle_arrived(self, news: tmtc_messages.K2aciArrived, now_ns: int) -> bool:
        """A message of the other end; False if it is not of the chat."""
        if news.kind != Chat.__name__:
            return False
        said = ChatRole(str(news.fields["sender"]))
        self._add(said, str(news.fields["text"]), "received", now_ns)
        return True

    def handle_update(self, update: tmtc_messages.K2aciUpdate) -> bool:
        """What became of a line; False if it is of another process."""
        if update.client != self._client:
            return False
        self._outbox.pop(update.id)
        self._settle(update.id, update.state, update.reason, update.round_trip_ms)
        return True

    def poll_transmit(self, now_ns: int) -> tmtc_messages.SendK2aci | None:
        while (number := self._outbox.next_given_up(now_ns)) is not None:
            self._outbox.pop(number)
            self._settle(number, "refused", _CHAT_SILENT, 0.0)
        due = self._outbox.poll_transmit(now_ns)
        return None if due is None else due[1].item

    def _add(self, sender: ChatRole, text: str, state: str, now_ns: int) -> int:
        number = next(self._numbers)
        at_us = now_ns // NS_PER_US
        line = texts.ChatLine(
            number=number, at_us=at_us, sender=str(sender), text=text, state=state
        )
        self._lines.append(line)
        return number

    def _settle(self, number: int, state: str, reason: str, round_trip_ms: float) -> None:
        for index, line in enumerate(self._lines):
            if line.number == number:
                self._lines[index] = replace(
                    line, state=state, reason=reason, round_trip_ms=round_trip_ms
                )

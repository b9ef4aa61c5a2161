"""The chat of an end: what its people wrote, what became of it, and what the others wrote."""

from collections import deque
from itertools import count

from msgspec.structs import replace

from kontur_av.clock import NS_PER_US
from pipelines.mission.tmtc_messages import K2aciArrived, K2aciUpdate, SendK2aci
from pipelines.seats.outbox import Outbox
from pipelines.seats.texts import ChatLine, ChatText
from telepresence.tmtc.k2aci import MAX_CHAT_OCTETS, Chat, ChatRole

_MOST_LINES = 100
_MOST_WAITING = 16
_SILENT = "telecommands and telemetry of this end do not answer"


class ChatLog:
    """Lines in the order in which this end knew them. A core.

    A line of this end waits until the other end has acknowledged it. The people of one end see
    each other's lines at once. client: new in each life of the process.
    """

    def __init__(self, client: str) -> None:
        self._client = client
        self._numbers = count(1)
        self._lines: deque[ChatLine] = deque(maxlen=_MOST_LINES)
        self._outbox: Outbox[SendK2aci] = Outbox()

    @property
    def text(self) -> ChatText:
        """All lines that are kept."""
        return ChatText(lines=tuple(self._lines))

    def handle_said(self, sender: ChatRole, text: str, now_ns: int) -> str:
        """A person of this end has written a line; return why it is not sent, or ""."""
        text = " ".join(text.split())
        octets = len(text.encode())
        if not text or not text.isprintable():
            return "write one line of text"
        if octets > MAX_CHAT_OCTETS:
            return f"a line of {octets} octets: write at most {MAX_CHAT_OCTETS}"
        if sum(line.state == "waiting" for line in self._lines) >= _MOST_WAITING:
            return f"{_MOST_WAITING} lines wait for the other end"
        number = self._add(sender, text, "waiting", now_ns)
        fields = {"sender": str(sender), "text": text}
        self._outbox.put(number, SendK2aci(self._client, number, "Chat", {**fields}), now_ns)
        return ""

    def handle_arrived(self, news: K2aciArrived, now_ns: int) -> bool:
        """A message of the other end; False if it is not of the chat."""
        if news.kind != Chat.__name__:
            return False
        said = ChatRole(str(news.fields["sender"]))
        self._add(said, str(news.fields["text"]), "received", now_ns)
        return True

    def handle_update(self, update: K2aciUpdate) -> bool:
        """What became of a line; False if it is of another process."""
        if update.client != self._client:
            return False
        self._outbox.handle_answer(update.id)
        self._settle(update.id, update.state, update.reason, update.round_trip_ms)
        return True

    def poll_transmit(self, now_ns: int) -> SendK2aci | None:
        """Return a message for this end's socket, or None."""
        while (number := self._outbox.next_event(now_ns)) is not None:
            self._settle(number, "refused", _SILENT, 0.0)
        return self._outbox.poll_transmit(now_ns)

    def _add(self, sender: ChatRole, text: str, state: str, now_ns: int) -> int:
        number = next(self._numbers)
        self._lines.append(
            ChatLine(
                number=number,
                at_us=now_ns // NS_PER_US,
                sender=str(sender),
                text=text,
                state=state,
            )
        )
        return number

    def _settle(self, number: int, state: str, reason: str, round_trip_ms: float) -> None:
        for index, line in enumerate(self._lines):
            if line.number == number:
                self._lines[index] = replace(
                    line, state=state, reason=reason, round_trip_ms=round_trip_ms
                )

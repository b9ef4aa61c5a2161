"""What waits for one client of Foxglove's protocol, and where it begins with pictures. Cores.

| what | most | when it is full |
|---|---|---|
| answers | 64 | the client is closed: it asks, and does not read |
| changed parameters | one value each | the newest replaces it |
| messages of channels | 4 MiB, 2 s | the oldest goes |

With a picture, all later ones of its channel go. It begins again, with a key picture, when the
client keeps up.

A stream has an IDR picture at its beginning and after a loss only. So a client that joins later, or
for which pictures were dropped, is sent a key picture that shows the picture before, and then all
units. Other clients are sent nothing of it.
"""

from collections import Counter, deque
from collections.abc import Mapping
from typing import Final, NamedTuple

from kontur_av.clock import NS_PER_S
from kontur_av.errors import ProtocolError
from kontur_av.media import CaptureStamp
from kontur_av.streams.coded_unit import CodedUnit
from pipelines.foxglove.protocol import Value, message_data, parameter_values, status
from pipelines.media.joined_units import JoinedUnits, StreamUnit
from pipelines.recording.channels import Source
from pipelines.recording.session_messages import ChannelMessage, Instants, SessionMessages
from pipelines.seats.open_page import MessageRate

MOST_OCTETS: Final = 4 << 20
MOST_AGE_NS: Final = 2 * NS_PER_S
#: What waits for a client that keeps up is younger.
_KEEPS_UP_NS = NS_PER_S // 5
_MOST_ANSWERS = 64
_REQUESTS_HZ, _REQUESTS_BURST = 50, 200
#: A client is told this often at most that messages were dropped.
_TOLD_NS = 5 * NS_PER_S


class _Waiting(NamedTuple):
    channel: str
    data: bytes
    since_ns: int


class Client:
    """One client. commands: whether it may call services."""

    def __init__(self, *, commands: bool) -> None:
        self.commands = commands
        #: By channel: messages sent and dropped.
        self.sent: Counter[str] = Counter()
        self.dropped: Counter[str] = Counter()
        #: By channel: the client's number for it.
        self._subscriptions: dict[str, int] = {}
        #: Channels of pictures in which it can decode the next unit.
        self._begun: set[str] = set()
        #: Those in which it could, until a unit was dropped.
        self._broken: set[str] = set()
        #: Whether it has taken anything since a message was dropped.
        self._takes = True
        #: Names of parameters that it follows.
        self.follows: set[str] = set()
        self._rate = MessageRate(_REQUESTS_HZ, _REQUESTS_BURST)
        self._answers: deque[bytes | str] = deque()
        self._changed: dict[str, Value] = {}
        self._messages: deque[_Waiting] = deque()
        self.waiting_octets = 0
        self._untold = False
        self._told_ns: int | None = None

    def handle_request(self, now_ns: int) -> None:
        """Something has come; ProtocolError if that is too often."""
        if not self._rate.handle_message(now_ns):
            raise ProtocolError("too many requests")

    # Subscriptions

    def subscribe(self, channel: str, number: int) -> str:
        """Return why a channel cannot be subscribed, or ""."""
        if channel in self._subscriptions:
            return f"{channel} is subscribed already"
        if number in self._subscriptions.values():
            return f"the subscription {number} is in use"
        self._subscriptions[channel] = number
        return ""

    def unsubscribe(self, number: int) -> None:
        """Forget a subscription, and what waits for it."""
        for channel in [name for name, one in self._subscriptions.items() if one == number]:
            del self._subscriptions[channel]
            self._begun.discard(channel)
            self._broken.discard(channel)
            self._remove(channel)

    def reads(self, channel: str) -> bool:
        return channel in self._subscriptions

    def lacks(self, channel: str, now_ns: int) -> bool:
        """Whether it can begin with the next unit of a channel of pictures, and has not."""
        keeps_up = self._takes and self.oldest_age_ns(now_ns) < _KEEPS_UP_NS
        return self.reads(channel) and channel not in self._begun and keeps_up

    def begin(self, channel: str) -> None:
        """Its next message of a channel of pictures is one at which a decoder can begin."""
        self._begun.add(channel)
        self._broken.discard(channel)

    def end(self, channel: str) -> None:
        """No decoder can go on with the next units of a channel of pictures."""
        self._begun.discard(channel)

    def has_begun(self, channel: str) -> bool:
        return channel in self._begun

    def handle_withheld(self, channel: str, count: int) -> None:
        """Units cannot be sent, because one before them was dropped."""
        if count and channel in self._broken:
            self._drop(channel, count)

    # What waits

    @property
    def waits(self) -> bool:
        return bool(self._answers or self._changed or self._messages)

    def oldest_age_ns(self, now_ns: int) -> int:
        return now_ns - self._messages[0].since_ns if self._messages else 0

    def put_answer(self, answer: bytes | str) -> None:
        """ProtocolError if the client does not read its answers."""
        if len(self._answers) >= _MOST_ANSWERS:
            raise ProtocolError("answers are not read")
        self._answers.append(answer)

    def put_parameters(self, values: dict[str, Value]) -> None:
        """These have changed; those that it does not follow are left out."""
        self._changed.update({name: values[name] for name in values.keys() & self.follows})

    def put(self, message: ChannelMessage, now_ns: int) -> None:
        """A message of a channel, if it is subscribed."""
        number = self._subscriptions.get(message.channel)
        if number is None:
            return
        data = message_data(number, max(0, message.log_ns), message.data)
        self._messages.append(_Waiting(message.channel, data, now_ns))
        self.waiting_octets += len(data)
        self.handle_time(now_ns)

    def handle_time(self, now_ns: int) -> None:
        """Drop what waits for too long."""
        while self.waiting_octets > MOST_OCTETS or self.oldest_age_ns(now_ns) > MOST_AGE_NS:
            oldest = self._messages.popleft()
            self.waiting_octets -= len(oldest.data)
            self._drop(oldest.channel, 1)
            if oldest.channel in self._begun:
                self._begun.discard(oldest.channel)
                self._broken.add(oldest.channel)
                self._drop(oldest.channel, self._remove(oldest.channel))
        if self._untold and (self._told_ns is None or now_ns - self._told_ns >= _TOLD_NS):
            self._told_ns, self._untold = now_ns, False
            if len(self._answers) < _MOST_ANSWERS:
                which = ", ".join(f"{name} {count}" for name, count in self.dropped.most_common(4))
                self._answers.append(status(f"too slow; messages dropped so far: {which}"))

    def _drop(self, channel: str, count: int) -> None:
        self.dropped[channel] += count
        self._untold, self._takes = True, False

    def _remove(self, channel: str) -> int:
        """Remove what waits of a channel; how many messages."""
        kept = deque(message for message in self._messages if message.channel != channel)
        removed = len(self._messages) - len(kept)
        self._messages = kept
        self.waiting_octets = sum(len(one.data) for one in kept)
        return removed

    def poll_transmit(self) -> bytes | str | None:
        """Return the next message, or None. Call it when the client can take one."""
        self._takes = True
        if self._answers:
            return self._answers.popleft()
        if self._changed:
            changed, self._changed = self._changed, {}
            return parameter_values(changed)
        if not self._messages:
            return None
        oldest = self._messages.popleft()
        self.waiting_octets -= len(oldest.data)
        self.sent[oldest.channel] += 1
        return oldest.data


class LiveVideo:
    """One stream in its channel. clients: all, by number."""

    def __init__(
        self, source: Source, messages: SessionMessages, clients: Mapping[int, Client]
    ) -> None:
        self._source, self._messages, self._clients = source, messages, clients
        self._channel = source.channels[0]
        self._joined = JoinedUnits()
        #: HEVC units that were withheld, over all clients.
        self.undecodable = 0

    def handle_unit(self, unit: CodedUnit, stamp: CaptureStamp, at: Instants) -> None:
        now_ns, channel, clients = at.now_ns, self._channel, self._clients.values()
        waiting = self._waiting(now_ns)
        joined = self._joined.handle_unit(unit, stamp, at.published_ns, waits=bool(waiting))
        if not any(client.reads(name) for client in clients for name in self._source.channels):
            return
        came = joined.live or StreamUnit(unit, stamp, at.published_ns, unit.data)
        picture, metadata = self._messages.of_unit(self._source, came, now_ns)
        for client in clients:
            if not unit.added:
                client.put(metadata, now_ns)
            if joined.anew or (unit.refused and unit.codec == "h265"):
                # The next units refer to what is missing, and decoders of HEVC conceal nothing.
                client.end(channel)
            if client.has_begun(channel):
                if joined.live is not None:
                    client.put(picture, now_ns)
                continue
            withheld = len(joined.before) + (joined.live is not None and client not in waiting)
            client.handle_withheld(channel, withheld)
            if unit.codec == "h265" and not joined.begin:
                self.undecodable += client.reads(channel)
        for client in waiting if joined.begin else ():
            client.begin(channel)
            for each in joined.begin:
                picture, metadata = self._messages.of_unit(self._source, each, now_ns)
                # What is too much for the client ends its beginning again.
                if client.has_begun(channel):
                    client.put(picture, now_ns)
                if each.unit.added:
                    client.put(metadata, now_ns)

    def poll_ask(self, now_ns: int) -> bool:
        """Return whether to ask the stream's coder for a key picture now."""
        return self._joined.poll_ask(now_ns, waits=bool(self._waiting(now_ns)))

    def _waiting(self, now_ns: int) -> list[Client]:
        return [each for each in self._clients.values() if each.lacks(self._channel, now_ns)]

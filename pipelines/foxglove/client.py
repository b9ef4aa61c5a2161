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
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from kontur_av.clock import NS_PER_S
from kontur_av.codecs.black_key import black_key
from kontur_av.errors import ProtocolError
from kontur_av.media import CaptureStamp, VideoCodec
from kontur_av.streams.coded_unit import CodedUnit
from pipelines.foxglove.protocol import Value, message_data, parameter_values, status
from pipelines.recording.channels import Source
from pipelines.recording.own_pictures import KEY_TIMEOUT_NS, MOST_HELD_OCTETS, StreamStart
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

    def handle_withheld(self, channel: str) -> None:
        """A unit cannot be sent, because one before it was dropped."""
        if channel in self._broken:
            self._drop(channel, 1)

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


#: A stream's key pictures are at least so far apart, however many clients come and go.
_APART_NS: Final = NS_PER_S


class KeyAsked(NamedTuple):
    """Make a key picture of the last picture of these access units, in this size."""

    channel: str
    number: int
    units: tuple[bytes, ...]
    width: int
    height: int


@dataclass(kw_only=True)
class _Held:
    """What waits for a key picture. takers: numbers of clients."""

    takers: Sequence[int]
    unit: CodedUnit
    stamp: CaptureStamp
    at: Instants
    pictures: list[ChannelMessage] = field(default_factory=list)


class LiveVideo:
    """One stream in its channel. clients: all, by number."""

    def __init__(
        self, source: Source, messages: SessionMessages, clients: Mapping[int, Client]
    ) -> None:
        self._source, self._messages, self._clients = source, messages, clients
        self.channel = source.channels[0]
        self._start = StreamStart()
        self._held: _Held | None = None
        self._key_ns: int | None = None
        self._asked: KeyAsked | None = None
        #: Of the newest key picture that was asked for.
        self._number = 0
        #: HEVC units that were withheld, over all clients.
        self.undecodable = 0
        self._codec: VideoCodec = "h264"

    def handle_unit(self, unit: CodedUnit, stamp: CaptureStamp, at: Instants) -> None:
        now_ns, self._codec = at.now_ns, unit.codec
        takers = []
        if self._held is None and (self._key_ns is None or now_ns - self._key_ns >= _APART_NS):
            takers = [
                number
                for number, client in self._clients.items()
                if client.lacks(self.channel, now_ns)
            ]
        begun = self._start.handle_unit(unit, stamp, now_ns, begins=bool(takers))
        channels, clients = self._source.channels, self._clients.values()
        if not any(client.reads(name) for client in clients for name in channels):
            return
        picture, metadata = self._messages.of_unit(self._source, unit, unit.data, stamp, at)
        waiting = takers if self._held is None else self._held.takers
        for number, client in self._clients.items():
            client.put(metadata, now_ns)
            # A client's decoder may close on a unit that ours refused.
            if unit.refused and unit.codec == "h265":
                # The next units refer to it, and decoders of HEVC conceal nothing.
                client.end(self.channel)
            elif unit.refused:
                continue
            if client.has_begun(self.channel):
                client.put(picture, now_ns)
                continue
            if number not in waiting:
                client.handle_withheld(self.channel)
            if unit.codec == "h265" and begun is None:
                self.undecodable += client.reads(self.channel)
        if self._held is not None and not unit.refused:
            self._held.pictures.append(picture)
            if sum(len(one.data) for one in self._held.pictures) > MOST_HELD_OCTETS:
                self._handle_key(None, now_ns)
        if begun is None:
            return
        if begun.data is not unit.data:
            picture, _ = self._messages.of_unit(self._source, unit, begun.data, stamp, at)
        self._held = _Held(takers=takers, unit=unit, stamp=stamp, at=at, pictures=[picture])
        if begun.key is None:
            self._release((), now_ns)
            return
        self._key_ns = now_ns
        if isinstance(begun.key, bytes):
            self._handle_key(begun.key, now_ns)
        else:
            self._number += 1
            self._asked = KeyAsked(self.channel, self._number, begun.key, unit.width, unit.height)

    def lacks_key(self, now_ns: int) -> bool:
        """Whether a client waits for a key picture of the stream itself: of HEVC none is made."""
        return self._codec == "h265" and any(
            client.lacks(self.channel, now_ns) for client in self._clients.values()
        )

    def next_event(self) -> KeyAsked | None:
        asked, self._asked = self._asked, None
        return asked

    def handle_made(self, asked: KeyAsked, key: bytes | None, now_ns: int) -> None:
        """The key picture is there; one that comes too late is left out.

        key: None if it could not be made; then a black one takes its place.
        """
        if asked.number == self._number:
            self._handle_key(key, now_ns)

    def _handle_key(self, key: bytes | None, now_ns: int) -> None:
        held = self._held
        if held is not None:
            key = key or black_key(held.unit.width, held.unit.height)
            told = self._messages.of_key(self._source, held.unit, key, held.stamp, held.at)
            self._release(told, now_ns)

    def handle_time(self, now_ns: int) -> None:
        if self._held is not None and now_ns - self._held.at.now_ns >= KEY_TIMEOUT_NS:
            self._handle_key(None, now_ns)

    def _release(self, key: Sequence[ChannelMessage], now_ns: int) -> None:
        held, self._held = self._held, None
        for number in () if held is None else held.takers:
            client = self._clients.get(number)
            if client is None or held is None or not client.reads(self.channel):
                continue
            client.begin(self.channel)
            for message in (*key, *held.pictures):
                # What is too much for the client ends its beginning again.
                if client.has_begun(self.channel):
                    client.put(message, now_ns)

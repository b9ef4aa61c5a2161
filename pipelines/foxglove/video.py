"""Where clients begin with a stream of pictures: behind a key picture. A core.

A stream has an IDR picture at its beginning and after a loss only. So a client that joins later, or
for which pictures were dropped, is sent a key picture that shows the picture before, and then all
units. Other clients are sent nothing of it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Final, NamedTuple

from kontur_av.clock import NS_PER_S
from kontur_av.codecs.black_key import black_key
from kontur_av.media import CaptureStamp, VideoCodec
from kontur_av.streams.coded_unit import CodedUnit
from pipelines.foxglove.client import Client
from pipelines.recording.channels import Source
from pipelines.recording.own_pictures import (
    KEY_PATIENCE_NS,
    MOST_HELD_OCTETS,
    StreamStart,
)
from pipelines.recording.session_messages import ChannelMessage, Instants, SessionMessages

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
        picture, facts = self._messages.of_unit(self._source, unit, unit.data, stamp, at)
        waiting = takers if self._held is None else self._held.takers
        for number, client in self._clients.items():
            client.put(facts, now_ns)
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
        if self._held is not None and now_ns - self._held.at.now_ns >= KEY_PATIENCE_NS:
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

"""Packets from the packet zones of one stream's frames; losses never join two packets.

It never raises because of data from the peer; invalid data is counted by reason and dropped.
"""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from telepresence.link.flows import (
    MAX_FLOWS,
    Flow,
    FlowKind,
    Level,
    LinkEvent,
    PacketReceived,
    SupervisionReceived,
)
from telepresence.link.frame import (
    CLOSED,
    KIND_BITS,
    KIND_SHIFT,
    LARGEST_SHORT_LENGTH,
    MAX_PACKET_OCTETS,
    NUMBER_MASK,
    TAG_FILL,
    TAG_PAD,
    TAG_RESUME,
    Pointers,
)
from telepresence.link.header_compression import KIND_WHOLE, RtpDecompressor
from telepresence.link.profile import SUPERVISION_OCTETS, LinkProfile

#: Bits of a packet's place for the position of its tag.
PLACE_SHIFT = 11
#: The level that each control code resumes; -1 for undefined codes.
_RESUMED = [-1] * TAG_RESUME + [*range(len(Level))]


@dataclass(slots=True)
class _Partial:
    """A packet whose end has not arrived yet."""

    tag: int
    place: int
    body: bytearray


class PacketReassembly:
    """Takes the packet zone of each frame of a stream, in order.

    flows: the direction's flow table, checked. events: where packets and messages are appended.

    received: by flow, in the table's order. dropped: by reason.
    deliver: while False, packets are dropped and counted as `unapproved`.
    hand_on: called with each whole packet: place, number of its flow, packet, instant. A packet's
        place in the stream is the frame count, then 11 bits of its tag's position in the zone.
    """

    def __init__(
        self, profile: LinkProfile, flows: Sequence[Flow], events: deque[LinkEvent]
    ) -> None:
        self.deliver = True
        self.hand_on: Callable[[int, int, bytes, int], None] = self.take
        self.flows = flows
        self.dropped: dict[str, int] = {}
        self.received = [0] * len(flows)
        self.supervision_received = 0
        self._events = events
        self._pointers = Pointers(profile)
        self._idle = self._pointers.idle
        self._no_start = self._pointers.no_start
        self._decompressors = [
            RtpDecompressor(flow, profile.slot_ns) if flow.kind is FlowKind.RTP else None
            for flow in flows
        ]
        self._levels = [int(flow.level) for flow in flows]
        self._levels += [-1] * (MAX_FLOWS - len(flows))
        self._partials: list[_Partial | None] = [None] * len(Level)
        #: The level of the packet that the next zone continues.
        self._on_air: int | None = None

    def handle_zone(self, pointer: int, zone: bytes, count: int, now_ns: int) -> None:
        """Take the zone of the frame `count`, and its first header pointer."""
        on_air = self._on_air
        if pointer == self._idle:
            if on_air is not None:
                self._finish(on_air, now_ns)
        elif pointer == self._no_start:
            if on_air is not None:
                self._extend(on_air, zone)
        elif pointer == self._pointers.supervision:
            self.supervision_received += 1
            self._events.append(SupervisionReceived(zone[:SUPERVISION_OCTETS], now_ns))
        elif pointer == self._pointers.preempt:
            self._parse_tags(zone, 0, count, now_ns)
        elif pointer > len(zone):
            self._malformed()
        else:
            if on_air is not None:
                self._extend(on_air, zone[:pointer])
                self._finish(self._on_air, now_ns)
            self._parse_tags(zone, pointer, count, now_ns)

    def fork(self, hand_on: Callable[[int, int, bytes, int], None]) -> "PacketReassembly":
        """Return another one in the same state, whose drops nobody counts."""
        other: PacketReassembly = _copy(self)
        other.hand_on, other.dropped = hand_on, {}
        other._partials = [
            partial and _Partial(partial.tag, partial.place, partial.body[:])
            for partial in self._partials
        ]
        other._decompressors = [
            decompressor and _copy(decompressor) for decompressor in self._decompressors
        ]
        return other

    def drop_incomplete(self) -> None:
        """Drop the packets whose end has not come."""
        for level, partial in enumerate(self._partials):
            if partial is not None:
                self._partials[level] = None
                self.drop("incomplete")
        self._on_air = None

    def forget_contexts(self) -> None:
        for decompressor in self._decompressors:
            if decompressor is not None:
                decompressor.forget()

    def go_on_from(self, other: "PacketReassembly", *, contexts: bool) -> None:
        """Take over the incomplete packets of another one, and with `contexts` its contexts."""
        self._partials, self._on_air = other._partials, other._on_air
        if contexts:
            self._decompressors = other._decompressors

    def drop(self, reason: str) -> None:
        self.dropped[reason] = self.dropped.get(reason, 0) + 1

    def _malformed(self) -> None:
        """The peer violates the tag format, so drop everything in progress."""
        self.drop("malformed")
        self.drop_incomplete()

    def _extend(self, level: int, piece: bytes) -> None:
        partial = self._partials[level]
        if partial is None:
            return
        partial.body += piece
        if len(partial.body) > MAX_PACKET_OCTETS + 16:
            self._partials[level] = None
            self._on_air = None
            self.drop("oversize")

    def _finish(self, level: int | None, now_ns: int) -> None:
        self._on_air = None
        if level is None:
            return
        partial = self._partials[level]
        self._partials[level] = None
        if partial is not None:
            self._finish_packet(partial.tag, partial.place, bytes(partial.body), now_ns)

    def _parse_tags(self, zone: bytes, position: int, count: int, now_ns: int) -> None:
        size = len(zone)
        self._on_air = None
        while position < size:
            tag = zone[position]
            place = count << PLACE_SHIFT | position
            position += 1
            if tag == TAG_PAD:
                continue
            if tag == TAG_FILL:
                return
            resumed = tag & KIND_BITS == 0
            level = (_RESUMED if resumed else self._levels)[tag & NUMBER_MASK]
            if level < 0:
                self._malformed()
                return
            end = size
            if tag & CLOSED:
                # Missing octets read as zeros; then the piece ends beyond the zone.
                length = int.from_bytes(zone[position : position + 1], "big")
                position += 1
                if length > LARGEST_SHORT_LENGTH:
                    low = int.from_bytes(zone[position : position + 1], "big")
                    length = (length & LARGEST_SHORT_LENGTH) << 8 | low
                    position += 1
                end = position + length
                if end > size:
                    self._malformed()
                    return
            piece = zone[position:end]
            position = end
            if not resumed:
                if self._partials[level] is not None:
                    # Each level has at most one packet in flight: the sender dropped this one.
                    self._partials[level] = None
                    self.drop("incomplete")
                if tag & CLOSED:
                    self._finish_packet(tag & ~CLOSED, place, piece, now_ns)
                else:
                    self._partials[level] = _Partial(tag, place, bytearray(piece))
                    self._on_air = level
                continue
            self._extend(level, piece)
            if tag & CLOSED:
                self._finish(level, now_ns)
            else:
                self._on_air = level

    def _finish_packet(self, tag: int, place: int, body: bytes, now_ns: int) -> None:
        number, kind = tag & NUMBER_MASK, tag >> KIND_SHIFT
        decompressor = self._decompressors[number]
        packet: bytes | str
        if decompressor is not None:
            packet = decompressor.decompress(kind, body, place >> PLACE_SHIFT)
            if isinstance(packet, str):
                self.drop(packet)
                return
        elif kind == KIND_WHOLE:
            packet = body
        else:
            self.drop("malformed")
            return
        self.hand_on(place, number, packet, now_ns)

    def take(self, place: int, number: int, packet: bytes, now_ns: int) -> None:
        """Append a packet to the events, if packets are delivered."""
        if self.deliver:
            self.received[number] += 1
            self._events.append(PacketReceived(self.flows[number], packet, now_ns))
        else:
            self.drop("unapproved")


def _copy(of: Any) -> Any:
    """A shallow copy, several times faster than `copy.copy`."""
    other = of.__new__(type(of))
    other.__dict__.update(of.__dict__)
    return other

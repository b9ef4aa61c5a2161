"""RTP headers in three octets, or one: each packet decodable from its context and itself.

A context is the full header of one earlier packet and the frame count at which that packet
started. The frame count is the link's own time, known to both ends: it predicts the timestamp
(or, for flows of constant stride, the sequence number), and the compressed header carries only
the low bits that pick the right value near the prediction. Nothing depends on the packet before,
so nothing has to converge after a loss.

The receiver may hold any context of the current generation that is at most
`CONTEXT_LIFE_SLOTS` old, because it may have missed the newer ones. So the compressor keeps all
of these and compresses only what comes out exact from every one of them; else it sends the
full header, as the first context of a new generation. A generation's number is not used again
before its last context has died, so a receiver never mistakes one for another.

The fields are those of RFC 3550 section 5.1. The scheme borrows the least-significant-bits
encoding of ROHC (RFC 5795), whose feedback and state machines a one-way 1 ms link can do without.
"""

import struct
from dataclasses import dataclass

from kontur_av.clock import NS_PER_S
from telepresence.link.flows import Flow
from telepresence.link.frame import TYPE_COMPRESSED, TYPE_CONTEXT, TYPE_RAW

RTP_HEADER = struct.Struct(">BBHII")
RTP_HEADER_OCTETS = RTP_HEADER.size

#: The first octet of a header without padding, extension and CSRC; only these are compressed.
PLAIN_RTP = 0x80

GENERATIONS = 4
REFRESH_SLOTS = 1_000
#: A gap of 10 s, with a refresh just missed before it and one just not due yet after it.
CONTEXT_LIFE_SLOTS = 12_200

#: How many sequence numbers the compressed header of a timed flow tells apart; so a generation
#: of contexts serves as many packets.
GENERATION_PACKETS = 1 << 9

_SEQUENCE_MASK = GENERATION_PACKETS - 1
_TIMESTAMP_BITS = 14
_TIMESTAMP_MASK = (1 << _TIMESTAMP_BITS) - 1
_TIMESTAMP_HALF = 1 << (_TIMESTAMP_BITS - 1)
_U32 = 0xFFFF_FFFF


@dataclass(frozen=True, slots=True)
class Context:
    """One full header: frame count at its packet's start, and the fields."""

    count: int
    payload_type: int
    sequence: int
    timestamp: int
    ssrc: int


class TimedForm:
    """Three octets: marker, 9 bits of sequence number, 14 bits of timestamp.

    For timestamps that are capture times: they follow the link's time up to the jitter between
    capture and start of transmission, which may be ±91 ms around the context's (at 90 kHz).
    """

    octets = 3

    def __init__(self, ticks: int, slot_units: int) -> None:
        self._ticks = ticks
        self._units = slot_units

    def pack(self, marker: int, sequence: int, timestamp: int) -> bytes | None:
        bits = marker << 23 | (sequence & _SEQUENCE_MASK) << 14 | timestamp & _TIMESTAMP_MASK
        return bits.to_bytes(3, "big")

    def unpack(self, header: bytes, context: Context, count: int) -> tuple[int, int, int]:
        """Marker, sequence number, timestamp. The sequence number lies 0..511 after the context's,
        the timestamp next to the prediction."""
        bits = int.from_bytes(header, "big")
        base = context.sequence
        sequence = base + ((bits >> 14) - base & _SEQUENCE_MASK) & 0xFFFF
        predicted = context.timestamp + (count - context.count) * self._ticks // self._units
        off = bits - predicted & _TIMESTAMP_MASK
        if off >= _TIMESTAMP_HALF:
            off -= _TIMESTAMP_MASK + 1
        return bits >> 23, sequence, predicted + off & _U32


class StrideForm:
    """One octet: 8 bits of sequence number; the timestamp advances by `stride` a packet.

    The link's time predicts the sequence number to ±128 packets (2.5 s of 20 ms packets). A set
    marker does not fit: such a packet takes its full header along.
    """

    octets = 1

    def __init__(self, ticks: int, slot_units: int, stride: int) -> None:
        self._ticks = ticks
        self._units = slot_units * stride
        self._stride = stride

    def pack(self, marker: int, sequence: int, timestamp: int) -> bytes | None:
        return None if marker else (sequence & 0xFF).to_bytes(1, "big")

    def unpack(self, header: bytes, context: Context, count: int) -> tuple[int, int, int]:
        """Marker (0), sequence number, timestamp."""
        steps = (count - context.count) * self._ticks // self._units
        off = header[0] - context.sequence - steps & 0xFF
        steps += off - 0x100 if off >= 0x80 else off
        return (
            0,
            context.sequence + steps & 0xFFFF,
            context.timestamp + steps * self._stride & _U32,
        )


def form_of(flow: Flow, slot_ns: int) -> TimedForm | StrideForm:
    """How `flow`'s headers are compressed. Ticks a slot are the fraction ticks / units."""
    ticks = flow.clock_hz * slot_ns
    if flow.stride_ticks:
        return StrideForm(ticks, NS_PER_S, flow.stride_ticks)
    return TimedForm(ticks, NS_PER_S)


class RtpCompressor:
    """One RTP flow's sending end."""

    def __init__(self, flow: Flow, slot_ns: int) -> None:
        self._form = form_of(flow, slot_ns)
        self._generation = GENERATIONS - 1
        self._contexts: list[Context] = []
        self._last_context_count: list[int | None] = [None] * GENERATIONS
        self.compressed = 0
        self.contexts = 0
        self.raw = 0
        self._refresh = False

    def refresh(self) -> None:
        """Send a context with the next packet: the receiving end has just begun to listen."""
        self._refresh = True

    def compress(self, data: bytes, count: int) -> tuple[int, bytes, int]:
        """Tag type, body, and how many octets of the body are header.

        data: an RTP packet. count: the frame count, not wrapped, of the frame it starts in.
        """
        if len(data) < RTP_HEADER_OCTETS or data[0] != PLAIN_RTP:
            self.raw += 1
            return TYPE_RAW, data, min(len(data), RTP_HEADER_OCTETS)
        _, second, sequence, timestamp, ssrc = RTP_HEADER.unpack_from(data)
        packet = Context(count, second & 0x7F, sequence, timestamp, ssrc)
        contexts = self._contexts
        while contexts and count - contexts[0].count > CONTEXT_LIFE_SLOTS:
            del contexts[0]
        header = self._form.pack(second >> 7, sequence, timestamp)
        # A set marker may not fit the form and yet follow the contexts' line.
        probe = header if header is not None else self._form.pack(0, sequence, timestamp)
        fits = bool(contexts) and probe is not None and self._exact(probe, packet)
        recent = bool(contexts) and count - contexts[-1].count < REFRESH_SLOTS
        if fits and header is not None and recent and not self._refresh:
            self.compressed += 1
            body = header + data[RTP_HEADER_OCTETS:]
            return TYPE_COMPRESSED + (self._generation << 4), body, len(header)
        if not fits:
            generation = self._free_generation(count)
            if generation is None:
                self.raw += 1
                return TYPE_RAW, data, RTP_HEADER_OCTETS
            self._generation = generation
            contexts.clear()
        contexts.append(packet)
        self._refresh = False
        self._last_context_count[self._generation] = count
        self.contexts += 1
        # The header's first octet is known but for its generation.
        body = bytes((PLAIN_RTP | self._generation,)) + data[1:]
        return TYPE_CONTEXT, body, RTP_HEADER_OCTETS

    def _exact(self, header: bytes, packet: Context) -> bool:
        """Whether every context the receiver may hold gives back exactly this packet's header."""
        unpack, count = self._form.unpack, packet.count
        for context in self._contexts:
            if context.ssrc != packet.ssrc or context.payload_type != packet.payload_type:
                return False
            _, sequence, timestamp = unpack(header, context, count)
            if sequence != packet.sequence or timestamp != packet.timestamp:
                return False
        return True

    def _free_generation(self, count: int) -> int | None:
        for step in range(1, GENERATIONS + 1):
            generation = (self._generation + step) % GENERATIONS
            last = self._last_context_count[generation]
            if last is None or count - last > CONTEXT_LIFE_SLOTS:
                return generation
        return None

    def report(self) -> dict[str, int]:
        """Packets by how their header went."""
        return {"compressed": self.compressed, "context": self.contexts, "raw": self.raw}


class RtpDecompressor:
    """One RTP flow's receiving end."""

    def __init__(self, flow: Flow, slot_ns: int) -> None:
        self._form = form_of(flow, slot_ns)
        self._contexts: list[Context | None] = [None] * GENERATIONS

    def forget(self) -> None:
        """The peer has restarted: its generations begin anew."""
        self._contexts = [None] * GENERATIONS

    def decompress(self, tag_type: int, body: bytes, count: int) -> bytes | str:
        """The RTP packet, or in one word the reason why there is none.

        count: the frame count, not wrapped, of the frame in which the packet started.
        """
        if tag_type == TYPE_RAW:
            return body
        if tag_type == TYPE_CONTEXT:
            if len(body) < RTP_HEADER_OCTETS or body[0] & ~(GENERATIONS - 1) != PLAIN_RTP:
                return "malformed"
            _, second, sequence, timestamp, ssrc = RTP_HEADER.unpack_from(body)
            self._contexts[body[0] & (GENERATIONS - 1)] = Context(
                count, second & 0x7F, sequence, timestamp, ssrc
            )
            return b"\x80" + body[1:]
        form = self._form
        context = self._contexts[(tag_type - TYPE_COMPRESSED) >> 4]
        if context is None or count - context.count > CONTEXT_LIFE_SLOTS:
            return "no_context"
        if len(body) < form.octets:
            return "malformed"
        marker, sequence, timestamp = form.unpack(body[: form.octets], context, count)
        second = marker << 7 | context.payload_type
        header = RTP_HEADER.pack(PLAIN_RTP, second, sequence, timestamp, context.ssrc)
        return header + body[form.octets :]

"""The bit layouts of compressed RTP headers, and the arithmetic that restores them. No state.

docs/link-format.md has the layouts of all rules and of a context, and the windows around their
predictions. Static rules, as in SCHC (RFC 8724): the tag's kind is the number of the rule. The
residue is what is sent besides the tag.

There are two differences from RFC 8724. Target values are not provisioned: SSRC and offsets are
random numbers of each sender, so a *context* carries them, and the receiver acknowledges it. And
they are not constant: the frame count, which both ends know, gives the source's progress since.

A source is modelled as a *grid*: pictures (or blocks of sound) at equal distances, each with about
the same number of packets. All residues are low bits of absolute values, so they do not depend on
the receiver's context. Each stands for the only value with these bits in a window around the
prediction.
"""

import struct
from collections.abc import Callable
from dataclasses import dataclass

from kontur_av.clock import NS_PER_S
from kontur_av.modular import serial_difference
from telepresence.link.flows import Flow

RTP_HEADER = struct.Struct(">BBHII")
RTP_HEADER_OCTETS = RTP_HEADER.size

#: First octet of a header without padding, extension and CSRC. Only such headers are compressed.
PLAIN_RTP = 0x80

#: Kinds of the tag octet.
KIND_RAW, KIND_CONTEXT = 1, 2
KIND_WIDE, KIND_BARE, KIND_SHORT, KIND_NEAR, KIND_LONG = 3, 4, 5, 8, 12

#: The header of a context packet: its number; marker and payload type, sequence number, timestamp
#: and SSRC of its packet; period in 1/64 ticks, packets a period in sixteenths, phase in ticks,
#: index and lead.
_CONTEXT = struct.Struct(">BBHIIBHBhB")
CONTEXT_OCTETS = _CONTEXT.size

#: Resolution of a period, in parts of a tick.
PERIOD_PARTS = 64
LARGEST_PERIOD = (1 << 24) - 1
#: Resolution of the packets a period, in parts of a packet.
RATE_PARTS = 16
LARGEST_RATE = 0xFF
#: The unit of the lead is this part of a second; the lead has six bits.
_LEADS_PER_S = 500
LARGEST_LEAD = 31

_U32 = 0xFFFF_FFFF
_INDEX_BACK = 2
_NEAR_BACK = 128
_LONG_BACK = 5120
_WIDE_BACK = 49152
_SHORT_SEQUENCE_BACK = 12
_LONG_SEQUENCE_BACK = 6
_WIDE_SEQUENCE_BACK = 64


@dataclass(frozen=True, slots=True)
class HeaderContext:
    """One packet's whole header, the time it was sent, and the prediction of its source.

    number: identifies the context in acknowledgements, 1 to 255; 0 if it is never acknowledged.
    count: frame count, not wrapped, of the frame in which its packet started.
    period: ticks from one grid point to the next, in 1/64.
    rate: packets a period, in sixteenths.
    phase: the packet's grid point minus its timestamp, in ticks.
    index: number of the grid point, modulo 4.
    lead: how much longer than usual the packet waited for the link, in units of `lead_ticks`.
    """

    number: int
    count: int
    marker: int
    payload_type: int
    sequence: int
    timestamp: int
    ssrc: int
    period: int
    rate: int
    phase: int
    index: int
    lead: int

    def pack(self) -> bytes:
        """Return `CONTEXT_OCTETS` octets."""
        return _CONTEXT.pack(
            self.number,
            self.marker << 7 | self.payload_type,
            self.sequence,
            self.timestamp,
            self.ssrc,
            self.period >> 16,
            self.period & 0xFFFF,
            self.rate,
            self.phase,
            self.index << 6 | self.lead + LARGEST_LEAD + 1,
        )


def parse_context(body: bytes, count: int) -> HeaderContext | None:
    """Return the context at the start of `body`, or None if it is invalid."""
    if len(body) < CONTEXT_OCTETS:
        return None
    fields = _CONTEXT.unpack_from(body)
    number, second, sequence, timestamp, ssrc, high, low, rate, phase, last = fields
    period = high << 16 | low
    if not period:
        return None
    return HeaderContext(
        number=number,
        count=count,
        marker=second >> 7,
        payload_type=second & 0x7F,
        sequence=sequence,
        timestamp=timestamp,
        ssrc=ssrc,
        period=period,
        rate=rate,
        phase=phase,
        index=last >> 6,
        lead=(last & 0x3F) - LARGEST_LEAD - 1,
    )


#: Marker, sequence number and timestamp.
Fields = tuple[int, int, int]

#: Packs (marker, sequence, timestamp, grid index) into (kind, residue).
_Pack = Callable[[int, int, int, int], tuple[int, bytes]]


class RtpForms:
    """The rules for one flow: `packers` return kind and residue, `unpack` restores the fields."""

    def __init__(self, flow: Flow, slot_ns: int) -> None:
        # The fraction ticks / units is the number of ticks in a slot.
        self._ticks = flow.clock_hz * slot_ns
        self._units = NS_PER_S
        self.lead_ticks = max(1, flow.clock_hz // _LEADS_PER_S)
        #: Cheapest first.
        self.packers: tuple[_Pack, ...] = (
            pack_bare,
            pack_short,
            pack_near,
            pack_long,
            pack_wide,
        )

    def slots_in_ticks(self, slots: int) -> int:
        return slots * self._ticks // self._units

    def unpack(self, kind: int, body: bytes, context: HeaderContext, count: int) -> Fields | None:
        """Restore the fields of a header of `kind` 3 to 15; None if `body` is too short."""
        if len(body) < residue_octets(kind):
            return None
        # Expected distance of the timestamp from the context's, for a packet with the usual wait.
        due = (count - context.count) * self._ticks // self._units + context.lead * self.lead_ticks
        period = context.period
        if kind >= KIND_LONG:
            bits = (kind - KIND_LONG) << 16 | body[0] << 8 | body[1]
            base = context.timestamp + due - _LONG_BACK
            timestamp = base + (bits - base & 0x1FFF)
            off = timestamp - context.timestamp - context.phase
            index = (2 * PERIOD_PARTS * off + period) // (2 * period)
            base = _sequence(context, index) - _LONG_SEQUENCE_BACK
            sequence = base + ((bits >> 13) - base & 0xF)
            return bits >> 17, sequence & 0xFFFF, timestamp & _U32
        index = (2 * PERIOD_PARTS * (due - context.phase) + period) // (2 * period)
        if kind == KIND_WIDE:
            base = context.timestamp + due - _WIDE_BACK
            timestamp = base + ((body[1] << 8 | body[2]) - base & 0xFFFF)
            base = _sequence(context, index) - _WIDE_SEQUENCE_BACK
            sequence = base + (body[0] - base & 0x7F)
            return body[0] >> 7, sequence & 0xFFFF, timestamp & _U32
        if kind == KIND_BARE:
            timestamp = _point(context, index)
            return context.marker, _sequence(context, index) & 0xFFFF, timestamp & _U32
        base = index - _INDEX_BACK
        octet = body[0]
        if kind >= KIND_NEAR:
            index = base + (kind - KIND_NEAR - context.index - base & 3)
            base = _point(context, index) - _NEAR_BACK
            timestamp = base + (octet - base & 0xFF)
            return context.marker, _sequence(context, index) & 0xFFFF, timestamp & _U32
        index = base + ((octet >> 5) - context.index - base & 3)
        timestamp = _point(context, index) & _U32
        beside = (kind - KIND_SHORT - timestamp % 3) % 3
        timestamp += -1 if beside == 2 else beside
        base = _sequence(context, index) - _SHORT_SEQUENCE_BACK
        sequence = base + (octet - base & 0x1F)
        return octet >> 7, sequence & 0xFFFF, timestamp & _U32

    def shortest(self, context: HeaderContext, count: int, fields: Fields) -> tuple[int, int]:
        """Return the index of the first of `packers` that fits, or `len(packers)` for none.

        The second value is the distance of the sequence number from the one for the link's time.
        """
        marker, sequence, timestamp = fields
        since = (count - context.count) * self._ticks // self._units
        due = since + context.lead * self.lead_ticks
        period, phase = context.period, context.phase
        off = serial_difference(timestamp - context.timestamp)
        index = (2 * PERIOD_PARTS * (off - phase) + period) // (2 * period)
        due_index = (2 * PERIOD_PARTS * (due - phase) + period) // (2 * period)
        error = serial_difference(sequence - _sequence(context, index), 16)
        steps = index - due_index
        late = (
            error if not steps else serial_difference(sequence - _sequence(context, due_index), 16)
        )
        if -_INDEX_BACK <= steps < 4 - _INDEX_BACK:
            beside = off - phase - (index * period + PERIOD_PARTS // 2) // PERIOD_PARTS
            plain = marker == context.marker and not error
            if plain and not steps and not beside:
                return 0, late
            back = _SHORT_SEQUENCE_BACK
            if -1 <= beside <= 1 and -back <= error < 0x20 - back:
                return 1, late
            if plain and -_NEAR_BACK <= beside < 0x100 - _NEAR_BACK:
                return 2, late
        back = _LONG_SEQUENCE_BACK
        if -_LONG_BACK <= off - due < 0x2000 - _LONG_BACK and -back <= error < 0x10 - back:
            return 3, late
        back = _WIDE_SEQUENCE_BACK
        if -_WIDE_BACK <= off - due < 0x10000 - _WIDE_BACK and -back <= late < 0x80 - back:
            return 4, late
        return 5, late


def residue_octets(kind: int) -> int:
    """Return how many octets of a compressed header follow its tag."""
    if kind >= KIND_LONG:
        return 2
    return 1 if kind > KIND_BARE else 0 if kind == KIND_BARE else 3


def pack_bare(marker: int, sequence: int, timestamp: int, index: int) -> tuple[int, bytes]:
    return KIND_BARE, b""


def pack_short(marker: int, sequence: int, timestamp: int, index: int) -> tuple[int, bytes]:
    octet = marker << 7 | (index & 3) << 5 | sequence & 0x1F
    return KIND_SHORT + timestamp % 3, bytes((octet,))


def pack_near(marker: int, sequence: int, timestamp: int, index: int) -> tuple[int, bytes]:
    return KIND_NEAR + (index & 3), bytes((timestamp & 0xFF,))


def pack_long(marker: int, sequence: int, timestamp: int, index: int) -> tuple[int, bytes]:
    bits = marker << 17 | (sequence & 0xF) << 13 | timestamp & 0x1FFF
    return KIND_LONG + (bits >> 16), (bits & 0xFFFF).to_bytes(2, "big")


def pack_wide(marker: int, sequence: int, timestamp: int, index: int) -> tuple[int, bytes]:
    bits = marker << 23 | (sequence & 0x7F) << 16 | timestamp & 0xFFFF
    return KIND_WIDE, bits.to_bytes(3, "big")


def _point(context: HeaderContext, index: int) -> int:
    """Return the timestamp, not wrapped, of the grid point `index` after the context's."""
    ticks = (index * context.period + PERIOD_PARTS // 2) // PERIOD_PARTS
    return context.timestamp + context.phase + ticks


def _sequence(context: HeaderContext, index: int) -> int:
    return context.sequence + (index * context.rate + RATE_PARTS // 2) // RATE_PARTS

"""The bit layouts of compressed RTP headers, and the arithmetic that turns them back. No state.

Static rules, as in SCHC (RFC 8724): the tag's kind is the rule's number, each rule says of each
field of RFC 3550 section 5.1 what it is compared with (the matching operator) and how it comes back
(the compression/decompression action), and what is sent besides the tag is the residue.

| field | target value | matching operator and action |
|---|---|---|
| version, P, X, CC | 2, 0, 0, 0 | equal, not sent |
| SSRC, payload type | the context's | equal, not sent |
| marker | the context's | equal, not sent (bare, near); or sent (short, long) |
| timestamp | computed from the link's time | equal, not sent (bare); or MSB(x), LSB |
| sequence number | computed from the timestamp | the same |

It differs from RFC 8724 in two points. Target values are not provisioned: SSRC and offsets are
random numbers of each sender, so a *context* tells them, and the receiver acknowledges it. And they
are not constant: the frame count, which both ends know, says how far the source has come since.

A source is modelled as a *grid*: pictures (or blocks of sound) at equal distances, with about as
many packets to each. The four rules, in octets with the tag:

    bare   1   kind 4         -                              just as predicted
    short  2   kind 5..7      marker 1, index 2, sequence 5  kind - 5 = timestamp modulo 3
    near   2   kind 8..11     timestamp 8                    kind - 8 = index modulo 4
    long   3   kind 12..15    marker 1, sequence 4, timestamp 13, of which the kind holds two bits

All residues are low bits of absolute values, hence the same whichever context the receiver holds;
each stands for the only value with these bits in a window around the prediction.

    short  timestamp: at a grid point or a tick beside it; for sources on a clock of their own
    near   timestamp: within 128 ticks of a grid point (1.4 ms at 90 kHz); for cameras
    long   timestamp: 5120 ticks before to 3071 after the link's time; for what is on no grid
    index  (number of the grid point): 2 before to 1 after the one that the link's time shows
    sequence: from 12 before to 19 after what the grid predicts (short), 6 before to 9 after (long)
"""

import struct
from collections.abc import Callable
from dataclasses import dataclass

from kontur_av.clock import NS_PER_S
from telepresence.link.flows import Flow

RTP_HEADER = struct.Struct(">BBHII")
RTP_HEADER_OCTETS = RTP_HEADER.size

#: The first octet of a header without padding, extension and CSRC; only these are compressed.
PLAIN_RTP = 0x80

#: Kinds of the tag octet.
KIND_RAW, KIND_CONTEXT = 1, 2
KIND_BARE, KIND_SHORT, KIND_NEAR, KIND_LONG = 4, 5, 8, 12

#: What a context packet has in front of the payload: its number; marker and payload type, sequence
#: number, timestamp and SSRC of its packet; period in 1/64 ticks, packets a period in sixteenths,
#: phase in ticks, index and lead.
_CONTEXT = struct.Struct(">BBHIIBHBhB")
CONTEXT_OCTETS = _CONTEXT.size

#: Parts of a tick in which a period is told.
PERIOD_PARTS = 64
LARGEST_PERIOD = (1 << 24) - 1
#: Parts of a packet in which the packets a period are told.
RATE_PARTS = 16
LARGEST_RATE = 0xFF
#: The lead's unit is this part of a second, and it has six bits.
_LEADS_PER_S = 500
LARGEST_LEAD = 31

_U32 = 0xFFFF_FFFF
_INDEX_BACK = 2
_NEAR_BACK = 128
_LONG_BACK = 5120
_SHORT_SEQUENCE_BACK = 12
_LONG_SEQUENCE_BACK = 6


@dataclass(frozen=True, slots=True)
class Context:
    """One packet's whole header, when it was sent, and how its source goes on from there.

    number: by which it is acknowledged, 1..255; 0 for one that nobody acknowledges.
    count: frame count, not wrapped, of the frame in which its packet started.
    period: ticks from one grid point to the next, in 1/64.
    rate: packets a period, in sixteenths.
    phase: the packet's grid point less its timestamp, in ticks.
    index: the grid point's number, modulo 4.
    lead: how much more than usual the packet had waited for the link, in ticks / `lead_ticks`.
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
        """`CONTEXT_OCTETS` octets."""
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


def parse_context(body: bytes, count: int) -> Context | None:
    """The context that `body` begins with; None where it can be none."""
    if len(body) < CONTEXT_OCTETS:
        return None
    fields = _CONTEXT.unpack_from(body)
    number, second, sequence, timestamp, ssrc, high, low, rate, phase, last = fields
    period = high << 16 | low
    if not period:
        return None
    return Context(
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

#: What is told from these, the grid index, and: the kind, and the residue.
_Pack = Callable[[int, int, int, int], tuple[int, bytes]]


class RtpForms:
    """The rules for one flow: `pack_*` make kind and residue, `unpack` gives the fields back."""

    def __init__(self, flow: Flow, slot_ns: int) -> None:
        # Ticks a slot are the fraction ticks / units.
        self._ticks = flow.clock_hz * slot_ns
        self._units = NS_PER_S
        self.lead_ticks = max(1, flow.clock_hz // _LEADS_PER_S)
        #: Cheapest first.
        self.packers: tuple[_Pack, ...] = (pack_bare, pack_short, pack_near, pack_long)

    def slots_in_ticks(self, slots: int) -> int:
        return slots * self._ticks // self._units

    def unpack(self, kind: int, body: bytes, context: Context, count: int) -> Fields | None:
        """The fields of a header of `kind` 4..15; None where `body` is too short."""
        if len(body) < residue_octets(kind):
            return None
        # The timestamp that a packet has now which waited as long as most do, from the context's.
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

    def shortest(self, context: Context, count: int, fields: Fields) -> tuple[int, int]:
        """Which of `packers` is the first to serve, `len(packers)` for none; and how far the
        sequence number is from what the grid predicts."""
        marker, sequence, timestamp = fields
        since = (count - context.count) * self._ticks // self._units
        due = since + context.lead * self.lead_ticks
        period, phase = context.period, context.phase
        off = signed32(timestamp - context.timestamp)
        index = (2 * PERIOD_PARTS * (off - phase) + period) // (2 * period)
        error = (sequence - _sequence(context, index) + 0x8000 & 0xFFFF) - 0x8000
        beside = off - phase - (index * period + PERIOD_PARTS // 2) // PERIOD_PARTS
        steps = index - (2 * PERIOD_PARTS * (due - phase) + period) // (2 * period)
        plain = marker == context.marker and not error
        if -_INDEX_BACK <= steps < 4 - _INDEX_BACK:
            if plain and not steps and not beside:
                return 0, error
            back = _SHORT_SEQUENCE_BACK
            if -1 <= beside <= 1 and -back <= error < 0x20 - back:
                return 1, error
            if plain and -_NEAR_BACK <= beside < 0x100 - _NEAR_BACK:
                return 2, error
        back = _LONG_SEQUENCE_BACK
        if -_LONG_BACK <= off - due < 0x2000 - _LONG_BACK and -back <= error < 0x10 - back:
            return 3, error
        return 4, error


def residue_octets(kind: int) -> int:
    """How many octets of a compressed header follow its tag."""
    return 2 if kind >= KIND_LONG else 1 if kind > KIND_BARE else 0


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


def signed32(difference: int) -> int:
    """A difference of two 32-bit numbers as the nearer one of its two readings."""
    return (difference + 0x8000_0000 & _U32) - 0x8000_0000


def _point(context: Context, index: int) -> int:
    """Timestamp, not wrapped, of the grid point `index` after the context's."""
    ticks = (index * context.period + PERIOD_PARTS // 2) // PERIOD_PARTS
    return context.timestamp + context.phase + ticks


def _sequence(context: Context, index: int) -> int:
    return context.sequence + (index * context.rate + RATE_PARTS // 2) // RATE_PARTS

"""H.264 in RTP, packetization-mode 1 (RFC 6184 section 6.3): access units to payloads, and back.

A payload is a single NAL unit, a STAP-A (several small NAL units) or an FU-A (one part of a large
NAL unit).
"""

from collections import deque
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from struct import pack, unpack_from
from typing import TYPE_CHECKING

from kontur_av.errors import ProtocolError

if TYPE_CHECKING:
    # The encoder splits NAL units, too, and must not load the rest of RTP.
    from kontur_av.rtp.receiver import RtpReceived

DEFAULT_MAX_PAYLOAD_OCTETS = 1200

NAL_SLICE, NAL_IDR, NAL_SEI, NAL_SPS, NAL_PPS = 1, 5, 6, 7, 8  # ITU-T H.264 table 7-1
STAP_A, FU_A = 24, 28  # RFC 6184 table 3

_TYPE_BITS, _NRI_BITS, _FORBIDDEN_BIT = 0x1F, 0x60, 0x80
_FU_START, _FU_END = 0x80, 0x40
_START_CODE = b"\x00\x00\x00\x01"


def split_annex_b(stream: bytes) -> list[bytes]:
    """Return the NAL units of an Annex B byte stream (ITU-T H.264 B.1), without start codes.

    Octets before the first start code and zeros after a NAL unit belong to none.
    """
    units = []
    start = stream.find(b"\x00\x00\x01")
    while start != -1:
        start += 3
        end = stream.find(b"\x00\x00\x01", start)
        unit = stream[start:] if end == -1 else stream[start:end]
        unit = unit.rstrip(b"\x00")
        if unit:
            units.append(unit)
        start = end
    return units


def join_annex_b(nal_units: Iterable[bytes]) -> bytes:
    """Return an Annex B byte stream of `nal_units`, each behind a start code of 4 octets."""
    return b"".join(_START_CODE + unit for unit in nal_units)


def nal_type(nal_unit: bytes) -> int:
    """Return nal_unit_type (ITU-T H.264 clause 7.3.1) of a NAL unit of at least one octet."""
    return nal_unit[0] & _TYPE_BITS


def parameter_sets(access_unit: bytes) -> bytes:
    """Return the SPS and PPS of an access unit as an Annex B byte stream; b"" if it has no SPS."""
    nals = [nal for nal in split_annex_b(access_unit) if nal_type(nal) in (NAL_SPS, NAL_PPS)]
    return join_annex_b(nals) if any(nal_type(nal) == NAL_SPS for nal in nals) else b""


def packetize(
    nal_units: Sequence[bytes], max_payload_octets: int = DEFAULT_MAX_PAYLOAD_OCTETS
) -> list[bytes]:
    """Return RTP payloads of at most `max_payload_octets` that carry `nal_units` in order.

    Neighbours that fit together share a STAP-A. A NAL unit that fits only alone is a payload of its
    own. A larger one is cut into FU-A parts of equal size, so that no small last packet costs a
    header of its own.

    Raises ValueError for a NAL unit of a type that RTP cannot carry (0 and 24 to 31), or if
    `max_payload_octets` is below 8.
    """
    if max_payload_octets < 8:
        raise ValueError(f"max_payload_octets {max_payload_octets}: at least 8")
    payloads: list[bytes] = []
    group: list[bytes] = []
    group_octets = 1
    for unit in nal_units:
        if not unit or not 1 <= nal_type(unit) <= 23:
            raise ValueError(f"a NAL unit that RTP cannot carry: {unit[:1].hex() or 'empty'}")
        needed = 2 + len(unit)
        if group and group_octets + needed > max_payload_octets:
            payloads.append(_aggregate(group))
            group, group_octets = [], 1
        if len(unit) > max_payload_octets:
            payloads.extend(_fragment(unit, max_payload_octets))
        else:
            group.append(unit)
            group_octets += needed
    if group:
        payloads.append(_aggregate(group))
    return payloads


def _aggregate(group: list[bytes]) -> bytes:
    if len(group) == 1:
        return group[0]
    # RFC 6184 section 5.7.1: F is the OR of all, NRI the largest of all.
    forbidden = max(unit[0] & _FORBIDDEN_BIT for unit in group)
    nri = max(unit[0] & _NRI_BITS for unit in group)
    parts = [bytes((forbidden | nri | STAP_A,))]
    for unit in group:
        parts += (pack("!H", len(unit)), unit)
    return b"".join(parts)


def _fragment(unit: bytes, max_payload_octets: int) -> list[bytes]:
    indicator = (unit[0] & (_FORBIDDEN_BIT | _NRI_BITS)) | FU_A
    kind = unit[0] & _TYPE_BITS
    body = unit[1:]
    parts = -(-len(body) // (max_payload_octets - 2))
    cuts = [len(body) * index // parts for index in range(parts + 1)]
    payloads = []
    for index in range(parts):
        header = kind
        if index == 0:
            header |= _FU_START
        if index == parts - 1:
            header |= _FU_END
        payloads.append(bytes((indicator, header)) + body[cuts[index] : cuts[index + 1]])
    return payloads


@dataclass(frozen=True, slots=True)
class Fragment:
    """The content of one payload: whole NAL units, or one part of a NAL unit (FU-A).

    is_part: `nal_units` has one element, a part of a NAL unit. The first part begins with the
        rebuilt NAL unit header.
    starts, ends: this part is the first, the last.
    """

    nal_units: tuple[bytes, ...]
    is_part: bool = False
    starts: bool = True
    ends: bool = True


def parse_payload(payload: bytes) -> Fragment:
    """Parse one RTP payload (RFC 6184 sections 5.6 to 5.8).

    Raises ProtocolError if it is no single NAL unit, STAP-A or FU-A.
    """
    if not payload:
        raise ProtocolError("an empty H.264 payload")
    kind = payload[0] & _TYPE_BITS
    if 1 <= kind <= 23:
        return Fragment((payload,))
    if kind == STAP_A:
        return Fragment(tuple(_disaggregate(payload)))
    if kind != FU_A:
        raise ProtocolError(f"H.264 payload type {kind} is no part of packetization-mode 1")
    if len(payload) < 3:
        raise ProtocolError("an FU-A without content")
    starts, ends = bool(payload[1] & _FU_START), bool(payload[1] & _FU_END)
    original = payload[1] & _TYPE_BITS
    # RFC 6184 section 5.8 forbids start and end in one FU, and nested types.
    if (starts and ends) or not 1 <= original <= 23:
        raise ProtocolError(f"an FU-A with the header {payload[1]:#04x}")
    body = payload[2:]
    if starts:
        body = bytes(((payload[0] & (_FORBIDDEN_BIT | _NRI_BITS)) | original,)) + body
    return Fragment((body,), is_part=True, starts=starts, ends=ends)


def _disaggregate(payload: bytes) -> list[bytes]:
    units = []
    position = 1
    while position < len(payload):
        if position + 2 > len(payload):
            raise ProtocolError("a STAP-A that ends inside a length field")
        (size,) = unpack_from("!H", payload, position)
        position += 2
        unit = payload[position : position + size]
        position += size
        if not unit or len(unit) < size or not 1 <= nal_type(unit) <= 23:
            raise ProtocolError("a STAP-A with an empty, cut or nested NAL unit")
        units.append(unit)
    if not units:
        raise ProtocolError("a STAP-A without content")
    return units


@dataclass(frozen=True, slots=True)
class ReceivedUnit:
    """One received access unit.

    data: an Annex B byte stream with start codes of 4 octets.
    timestamp: its 32-bit RTP timestamp.
    keyframe: it holds an IDR slice.
    damaged: packets of it are missing.
    lost_before: packets lost directly before its first packet, or in a unit before it that was
        dropped whole. They belonged to earlier access units or to non-slice NAL units at its head,
        which cannot be told apart.
    first_received_ns, received_ns: when its first and its last packet came.

    A unit that is not damaged and has no loss before it equals the unit sent. Exception: the first
    unit of a stream that was joined late may lack non-slice NAL units.
    """

    data: bytes
    timestamp: int
    keyframe: bool
    damaged: bool
    lost_before: int
    first_received_ns: int
    received_ns: int


class H264Depacketizer:
    """Packets in sequence order in, access units out (RFC 6184). It needs no time.

    Pass each packet of an RtpReceiver to `handle_packet`, then call `next_event` until None. An
    access unit ends with the marker bit or, for senders without it, when the timestamp changes.

    parameter_sets: SPS and PPS NAL units of the SDP (sprop-parameter-sets). They go before the
        first access unit and before each IDR picture, if the stream has none there.
    max_unit_octets: a larger access unit is dropped as garbage, so that no peer fills the memory.
    """

    def __init__(
        self, parameter_sets: Sequence[bytes] = (), *, max_unit_octets: int = 4 << 20
    ) -> None:
        self._parameter_sets = tuple(parameter_sets)
        self._max_unit_octets = max_unit_octets
        self._ready: deque[ReceivedUnit] = deque()
        self._source: int | None = None
        self._parameters_seen = False
        self._joining = True
        self._open = False
        #: Packets lost in units that were dropped whole: the next unit has them before it.
        self._lost_whole = 0
        self._begin(0, 0, 0)
        #: Payloads that were not H.264, and access units of more than `max_unit_octets`.
        self.garbage = 0
        #: Access units returned, those of them that were damaged, and those dropped because no
        #: whole NAL unit of them came.
        self.units = 0
        self.units_damaged = 0
        self.units_dropped = 0

    def _begin(self, timestamp: int, lost_before: int, received_ns: int) -> None:
        self._timestamp = timestamp
        self._lost_before = lost_before + self._lost_whole
        self._lost_within = self._lost_whole = 0
        self._first_received_ns = self._received_ns = received_ns
        self._nal_units: list[bytes] = []
        self._parts: list[bytes] = []
        self._octets = 0
        self._damaged = False
        self._too_large = False

    def handle_packet(self, packet: "RtpReceived") -> None:
        """Handle the next packet in sequence. Garbage is counted and never raises."""
        if packet.ssrc != self._source or packet.restart:
            if self._open:
                self._finish(complete=False)
            self._source = packet.ssrc
            self._parameters_seen = False
            self._joining = True
        if self._open and packet.timestamp != self._timestamp:
            self._finish(complete=packet.lost_before == 0)
        if not packet.payload:
            return
        if not self._open:
            self._begin(packet.timestamp, packet.lost_before, packet.received_ns)
            self._open = True
        elif packet.lost_before:
            self._lost_within += packet.lost_before
            self._break_part()
            self._damaged = True
        self._received_ns = packet.received_ns
        self._take(packet.payload)
        if packet.marker:
            self._finish(complete=True)

    def _take(self, payload: bytes) -> None:
        try:
            fragment = parse_payload(payload)
        except ProtocolError:
            self.garbage += 1
            self._break_part()
            self._damaged = True
            return
        self._octets += len(payload)
        if self._octets > self._max_unit_octets:
            self._too_large = True
            self._nal_units.clear()
            self._parts.clear()
            return
        if not fragment.is_part:
            self._break_part()
            self._nal_units.extend(fragment.nal_units)
            return
        if fragment.starts:
            self._break_part()
        elif not self._parts:
            self._damaged = True
            return
        self._parts.append(fragment.nal_units[0])
        if fragment.ends:
            self._nal_units.append(b"".join(self._parts))
            self._parts.clear()

    def _break_part(self) -> None:
        if self._parts:
            self._damaged = True
            self._parts.clear()

    def _finish(self, *, complete: bool) -> None:
        self._open = False
        self._break_part()
        if self._too_large:
            self.garbage += 1
            self._lost_whole = max(self._lost_before + self._lost_within, 1)
            return
        units = self._nal_units
        if not units:
            self.units_dropped += 1
            # The next unit may be predicted from this one.
            self._lost_whole = self._lost_before + self._lost_within
            return
        kinds = [nal_type(unit) for unit in units]
        head_unsure = self._lost_before > 0 or self._joining
        damaged = self._damaged or not complete or (head_unsure and _lacks_its_head(units))
        self._joining = False
        self.units += 1
        self.units_damaged += damaged
        self._ready.append(
            ReceivedUnit(
                join_annex_b(self._with_parameters(units, kinds)),
                self._timestamp,
                NAL_IDR in kinds,
                damaged,
                self._lost_before,
                self._first_received_ns,
                self._received_ns,
            )
        )

    def _with_parameters(self, units: list[bytes], kinds: list[int]) -> list[bytes]:
        wanted = not self._parameters_seen or NAL_IDR in kinds
        self._parameters_seen = True
        if NAL_SPS in kinds or not wanted:
            return units
        return [*self._parameter_sets, *units]

    def next_event(self) -> ReceivedUnit | None:
        """Return the next access unit, or None until more packets come."""
        return self._ready.popleft() if self._ready else None


def _lacks_its_head(units: list[bytes]) -> bool:
    """Return whether the first slice is not the picture's first (ITU-T H.264 clause 7.3.3).

    first_mb_in_slice is the first field of the slice header, in Exp-Golomb code. It is 0 if the
    first bit is 1.
    """
    for unit in units:
        if nal_type(unit) in (NAL_SLICE, NAL_IDR):
            return len(unit) > 1 and not unit[1] & 0x80
    return False

"""NAL units in RTP, as H.264 and HEVC have them: access units to payloads, and back.

A payload is a single NAL unit, an aggregation of several small ones, or a fragment of a large one.
"""

import re
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from struct import pack, unpack_from
from typing import TYPE_CHECKING, ClassVar, NamedTuple

from kontur_av.clock import NS_PER_MS
from kontur_av.errors import ProtocolError
from kontur_av.media import VideoCodec
from kontur_av.modular import serial_difference
from kontur_av.rtp.annex_b import join_annex_b, split_annex_b

if TYPE_CHECKING:
    # The encoder splits NAL units, too, and must not load the rest of RTP.
    from kontur_av.rtp.receiver import RtpReceived

DEFAULT_MAX_PAYLOAD_OCTETS = 1200

_FU_START, _FU_END = 0x80, 0x40
_START_CODE = b"\x00\x00\x00\x01"

#: A regular expression finds it in a third of the time of `in`.
_CODE = re.compile(b"\x00\x00\x01")
#: How long the first marked picture waits for a sign that it goes on behind its marker.
_MARKER_TRIED_NS = 40 * NS_PER_MS
#: How long a picture that no marker ends waits for its successor.
_UNMARKED_NS = 500 * NS_PER_MS


class Fragment(NamedTuple):
    """The content of one payload: whole NAL units, or one part of a NAL unit (a fragment).

    is_part: `nal_units` has one element, a part of a NAL unit. The first part begins with the
        rebuilt NAL unit header.
    starts, ends: this part is the first, the last.
    """

    nal_units: tuple[bytes, ...]
    is_part: bool = False
    starts: bool = True
    ends: bool = True


#: A packet without content, such as padding that keeps a path open.
_NOTHING = Fragment(())


class NalFormat:
    """The NAL units of one codec, and its payloads in RTP. It has no state.

    header_octets: of a NAL unit. largest: the largest type of a NAL unit that RTP can carry.
    aggregate, fragment: the types of the two payload structures.
    sps, sei: types of NAL units. set_names: by type, the names of parameter sets. slices: types
        that tell whether they are a picture's first. keys: those of pictures at which every decoder
        can start. leading: those of pictures that may refer to ones before the last key picture.
    beginners: types that begin the next access unit behind a picture.
    """

    codec: ClassVar[VideoCodec]
    header_octets: ClassVar[int]
    largest: ClassVar[int]
    aggregate: ClassVar[int]
    fragment: ClassVar[int]
    sps: ClassVar[int]
    sei: ClassVar[int]
    set_names: ClassVar[Mapping[int, str]]
    slices: ClassVar[frozenset[int]]
    keys: ClassVar[frozenset[int]]
    leading: ClassVar[frozenset[int]] = frozenset()
    beginners: ClassVar[frozenset[int]]

    @property
    def sets(self) -> frozenset[int]:
        """The types of parameter sets."""
        return frozenset(self.set_names)

    def nal_type(self, nal_unit: bytes) -> int:
        """Return nal_unit_type of a NAL unit of at least one octet."""
        raise NotImplementedError

    def is_nal(self, nal_unit: bytes) -> bool:
        """Return whether these octets begin with the header of a NAL unit."""
        raise NotImplementedError

    def aggregate_header(self, units: Sequence[bytes]) -> bytes:
        """Return the payload header of an aggregation of these NAL units."""
        raise NotImplementedError

    def fragment_header(self, unit: bytes) -> bytes:
        """Return the payload header of a fragment of this NAL unit."""
        raise NotImplementedError

    def nal_header(self, payload_header: bytes, kind: int) -> bytes:
        """Return the header of a NAL unit of type `kind` from its fragment's payload header."""
        raise NotImplementedError

    def parameter_sets(self, access_unit: bytes) -> bytes:
        """Return the parameter sets of an access unit, as Annex B; b"" if it has no SPS."""
        nals = [nal for nal in split_annex_b(access_unit) if self.nal_type(nal) in self.sets]
        return join_annex_b(nals) if any(self.nal_type(nal) == self.sps for nal in nals) else b""

    def is_later_slice(self, unit: bytes) -> bool:
        """Return whether it is a slice, but not the picture's first.

        In H.264, first_mb_in_slice is the first field of the slice header, in Exp-Golomb code: 0 if
        the first bit is 1 (clause 7.3.3). In HEVC, that bit is first_slice_segment_in_pic_flag.
        """
        at = self.header_octets
        return len(unit) > at and self.nal_type(unit) in self.slices and not unit[at] & 0x80

    def lacks_its_head(self, units: list[bytes]) -> bool:
        """Return whether the first slice of a picture is missing."""
        return self.is_later_slice(
            next(unit for unit in units if self.nal_type(unit) in self.slices)
        )

    def head(self, part: bytes) -> bytes:
        """Return the first part of a NAL unit without a start code before it."""
        code = -1 if self.is_nal(part) else part.find(b"\x00\x00\x01", 0, 8)
        return part if code < 0 else part[code + 3 :] or part

    def without_start_codes(self, unit: bytes) -> list[bytes]:
        """Divide a payload that should be one NAL unit, as most are. Zeros are skipped."""
        if not _CODE.search(unit):
            unit = unit if unit[-1] else unit.rstrip(b"\x00")
            return [unit] if unit and self.is_nal(unit) else []
        # What stands before the first start code is a NAL unit, too, unless it is all zeros.
        return [one for one in split_annex_b(_START_CODE + unit) if self.is_nal(one)]

    def packetize(
        self, nal_units: Sequence[bytes], max_payload_octets: int = DEFAULT_MAX_PAYLOAD_OCTETS
    ) -> list[bytes]:
        """Return RTP payloads of at most `max_payload_octets` that carry `nal_units` in order.

        Neighbours that fit together share an aggregation. A NAL unit that fits only alone is a
        payload of its own. A larger one is cut into fragments of equal size, so that no small last
        packet costs a header of its own.

        Raises ValueError for a NAL unit that RTP cannot carry, or if `max_payload_octets` is below
        8.
        """
        if max_payload_octets < 8:
            raise ValueError(f"max_payload_octets {max_payload_octets}: at least 8")
        payloads: list[bytes] = []
        group: list[bytes] = []
        group_octets = self.header_octets
        for unit in nal_units:
            if not unit or not self.is_nal(unit) or self.nal_type(unit) > self.largest:
                raise ValueError(f"a NAL unit that RTP cannot carry: {unit[:2].hex() or 'empty'}")
            needed = 2 + len(unit)
            if group and group_octets + needed > max_payload_octets:
                payloads.append(self._aggregated(group))
                group, group_octets = [], self.header_octets
            if len(unit) > max_payload_octets:
                payloads.extend(self._fragmented(unit, max_payload_octets))
            else:
                group.append(unit)
                group_octets += needed
        if group:
            payloads.append(self._aggregated(group))
        return payloads

    def _aggregated(self, group: list[bytes]) -> bytes:
        if len(group) == 1:
            return group[0]
        parts = [self.aggregate_header(group)]
        for unit in group:
            parts += (pack("!H", len(unit)), unit)
        return b"".join(parts)

    def _fragmented(self, unit: bytes, max_payload_octets: int) -> list[bytes]:
        header, kind = self.fragment_header(unit), self.nal_type(unit)
        body = unit[self.header_octets :]
        parts = -(-len(body) // (max_payload_octets - len(header) - 1))
        cuts = [len(body) * index // parts for index in range(parts + 1)]
        payloads = []
        for index in range(parts):
            told = kind | _FU_START * (index == 0) | _FU_END * (index == parts - 1)
            payloads.append(header + bytes((told,)) + body[cuts[index] : cuts[index + 1]])
        return payloads

    def parse_payload(self, payload: bytes) -> Fragment:
        """Parse one RTP payload (RFC 6184 sections 5.6 to 5.8, RFC 7798 section 4.4).

        What FFmpeg takes is taken, too: a fragment that starts and ends, start codes of Annex B and
        zeros around NAL units. Raises ProtocolError for anything else.
        """
        if not payload:
            raise ProtocolError("an empty payload")
        kind = self.nal_type(payload)
        if kind <= self.largest:
            units = self.without_start_codes(payload)
            if not units and any(payload):
                raise ProtocolError("a payload without a NAL unit")
            return Fragment(tuple(units))
        if kind == self.aggregate:
            return Fragment(tuple(self._disaggregated(payload)))
        if kind != self.fragment:
            raise ProtocolError(f"a payload of type {kind}: no NAL unit, aggregation or fragment")
        at = self.header_octets
        if len(payload) <= at:
            raise ProtocolError("a fragment without its header")
        starts, ends = bool(payload[at] & _FU_START), bool(payload[at] & _FU_END)
        original = payload[at] & ~(_FU_START | _FU_END)
        if self.codec == "h264":
            original &= 0x1F  # a reserved bit stands before the type
        if original > self.largest:
            raise ProtocolError(f"a fragment with the header {payload[at]:#04x}")
        body = payload[at + 1 :]
        if starts:
            body = self.nal_header(payload[:at], original) + body
        if starts and ends:
            return Fragment(tuple(self.without_start_codes(body)))
        return Fragment((body,), is_part=True, starts=starts, ends=ends)

    def _disaggregated(self, payload: bytes) -> list[bytes]:
        units: list[bytes] = []
        position = self.header_octets
        # One or two octets at the end are no NAL unit, nor is one without octets.
        while position + 2 < len(payload):
            (size,) = unpack_from("!H", payload, position)
            position += 2
            unit = payload[position : position + size]
            position += size
            if len(unit) < size or (unit and self.nal_type(unit) > self.largest):
                raise ProtocolError("an aggregation with a cut or nested NAL unit")
            if unit:
                units += self.without_start_codes(unit)
        if not units:
            raise ProtocolError("an aggregation without content")
        return units


@dataclass(frozen=True, slots=True)
class ReceivedUnit:
    """One received access unit.

    data: an Annex B byte stream with start codes of 4 octets.
    timestamp: its 32-bit RTP timestamp.
    keyframe: it holds a slice of a key picture: IDR, or any IRAP of HEVC.
    damaged: packets of it are missing.
    lost_before: packets lost directly before its first packet, or in a unit before it that was
        dropped whole. They belonged to earlier access units or to non-slice NAL units at its head,
        which cannot be told apart.
    first_received_ns, received_ns: when its first and its last packet came. codec: its codec.
    leading: it may refer to pictures before the last key picture, as RASL pictures of HEVC do.

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
    codec: VideoCodec = "h264"
    leading: bool = False


class NalDepacketizer:
    """Packets in sequence order in, access units out (RFC 6184, RFC 7798).

    Pass each packet of an RtpReceiver to `handle_packet`, and call `handle_timeout` at
    `poll_timeout`. Then call `next_event` until None.

    An access unit ends where the next one begins: before a first slice, or before what goes ahead
    of one (ITU-T H.264 clause 7.4.1.2.3, H.265 clause 7.4.2.4.4). After a loss it ends where the
    timestamp changes. The marker ends it sooner, once the first picture has shown that no more of
    it follows; so a sender that marks each slice is recognised. Parameter sets and SEI without a
    picture go with the next one.

    form: of the payloads.
    parameter_sets: NAL units of the SDP. They go before the first access unit and before each key
        picture, until the stream has brought its own.
    marked: the sender is known to mark the last packet of each picture alone, so that the first
        picture need not wait.
    max_unit_octets: a larger access unit is dropped as garbage, so that no peer fills the memory.
    """

    def __init__(
        self,
        form: NalFormat,
        parameter_sets: Sequence[bytes] = (),
        *,
        marked: bool = False,
        max_unit_octets: int = 4 << 20,
    ) -> None:
        self._form = form
        self._parameter_sets = tuple(parameter_sets)
        self._max_unit_octets = max_unit_octets
        self._ready: deque[ReceivedUnit] = deque()
        self._source: int | None = None
        self._parameters_seen = False
        self._joining = True
        self._open = False
        #: Whether the marker ends pictures; None: not known yet.
        self._first_markers: bool | None = True if marked else None
        self._markers = self._first_markers
        #: The timestamp of a picture that has just been ended by its marker.
        self._ended_at: int | None = None
        #: Packets lost in units that were dropped whole, and before packets without content.
        self._lost_whole = self._lost_idle = 0
        #: NAL units that wait for their picture.
        self._ahead: list[bytes] = []
        self._begin(0, 0, 0)
        #: Payloads that were malformed, and access units of more than `max_unit_octets`.
        self.garbage = 0
        #: Access units returned, and those that were damaged or lost whole.
        self.units = 0
        self.units_damaged = 0
        #: The timestamp of the newest unit, and the least step from one to the next; 0: not known.
        self._newest: int | None = None
        self._period = 0

    def _begin(self, timestamp: int, lost_before: int, received_ns: int) -> None:
        self._timestamp = timestamp
        self._lost_before = lost_before + self._lost_whole
        self._lost_within = self._lost_whole = 0
        self._first_received_ns = self._received_ns = received_ns
        self._nal_units, self._ahead = self._ahead, []
        self._parts: list[bytes] = []
        self._octets = sum(map(len, self._nal_units)) if self._nal_units else 0
        self._has_picture = self._has_first = self._marked = False
        self._damaged = False
        self._too_large = False

    def handle_packet(self, packet: "RtpReceived") -> None:
        """Handle the next packet in sequence. Garbage is counted and never raises."""
        if packet.ssrc != self._source or packet.restart:
            if self._open:
                self._finish(complete=self._marked or self._markers is False)
            self._source = packet.ssrc
            self._joining = True
            self._markers, self._ended_at = self._first_markers, None
            self._newest = None
            self._ahead.clear()
        lost = packet.lost_before + self._lost_idle
        self._lost_idle = 0
        try:
            fragment = self._form.parse_payload(packet.payload) if packet.payload else _NOTHING
        except ProtocolError:
            self.garbage += 1
            if self._open:
                self._break_part()
                self._damaged = True
            return
        if not fragment.nal_units:
            self._lost_idle = lost
        elif fragment.is_part and not fragment.starts:
            if lost or not self._parts or packet.timestamp != self._timestamp:
                self._place(None, packet, lost)
            if self._parts:
                self._parts.append(fragment.nal_units[0])
            else:
                self._damaged = True
        elif fragment.is_part:
            self._place(self._form.head(fragment.nal_units[0]), packet, lost)
            self._parts.append(fragment.nal_units[0])
        for unit in () if fragment.is_part else fragment.nal_units:
            self._place(unit, packet, lost)
            self._nal_units.append(unit)
            lost = 0
        if not self._open:
            return
        self._received_ns = packet.received_ns
        self._octets += len(packet.payload)
        if self._octets > self._max_unit_octets:
            self._too_large = True
            self._nal_units.clear()
            self._parts.clear()
        if fragment.is_part and fragment.ends:
            self._join_parts()
        if packet.marker:
            self._handle_marker()

    def _place(self, unit: bytes | None, packet: "RtpReceived", lost: int) -> None:
        """Prepare for a NAL unit, or its first part; None: for a later part of the present one."""
        form = self._form
        kind = -1 if unit is None else form.nal_type(unit)
        goes_on = unit is None or form.is_later_slice(unit)
        ended_first = self._ended_at is not None and self._has_first
        if self._open:
            if self._parts and unit is not None and not lost:
                # No packet is missing, so the sender forgot to mark the last part.
                self._join_parts()
            later = packet.timestamp != self._timestamp
            # A sender may date each slice: a later one belongs to the first one before it.
            new = later and not (goes_on and self._has_first)
            by_time = (later and lost) or (new and (self._marked or not self._has_picture))
            by_content = not goes_on and (later or kind in form.slices or kind in form.beginners)
            if by_time or (by_content and self._has_picture):
                # The next access unit starts.
                if self._markers is None and self._has_picture and (self._marked or not lost):
                    self._markers = self._marked
                self._finish(complete=self._marked or not lost)
        if not self._open:
            self._begin(packet.timestamp, lost, packet.received_ns)
            self._open = True
        elif lost:
            self._lost_within += lost
            self._break_part()
            self._damaged = True
        if goes_on:
            if self._ended_at == packet.timestamp or (ended_first and not lost):
                self._markers, self._damaged = False, True
            elif self._marked:
                self._markers = False
            self._marked = False
        self._ended_at = None
        if kind in form.slices:
            self._has_picture = True
            self._has_first |= not goes_on

    def _join_parts(self) -> None:
        if self._parts:
            # Start codes of Annex B inside the parts divide them into several NAL units.
            units = self._form.without_start_codes(b"".join(self._parts))
            self._parts.clear()
            self._nal_units += units
            self._has_picture |= any(
                self._form.nal_type(unit) in self._form.slices for unit in units
            )

    def _handle_marker(self) -> None:
        self._marked = True
        if self._markers is not False or not self._has_picture:
            self._join_parts()
        if self._markers or not self._has_picture:
            self._ended_at = self._timestamp if self._has_picture else None
            self._finish(complete=True)

    def _break_part(self) -> None:
        if self._parts:
            self._damaged = True
            self._parts.clear()

    def handle_timeout(self, now_ns: int) -> None:
        """End a picture that has waited long enough. Drain `next_event` afterwards."""
        due_ns = self.poll_timeout()
        if due_ns is not None and now_ns >= due_ns:
            if self._marked and self._markers is None:
                self._markers = True
                self._ended_at = self._timestamp
            self._join_parts()
            self._finish(complete=True)

    def poll_timeout(self) -> int | None:
        """Return when to call `handle_timeout`; None: not yet."""
        if not self._open or not self._has_picture or self._markers:
            return None
        tried = self._marked and self._markers is None
        return self._received_ns + (_MARKER_TRIED_NS if tried else _UNMARKED_NS)

    def _finish(self, *, complete: bool) -> None:
        self._open = False
        self._break_part()
        if self._too_large:
            self.garbage += 1
            self._lost_whole = max(self._lost_before + self._lost_within, 1)
            return
        units = self._nal_units
        form = self._form
        kinds = [form.nal_type(unit) for unit in units]
        if form.slices.isdisjoint(kinds):
            # The next unit may be predicted from this one.
            self._lost_whole = self._lost_before + self._lost_within
            self._ahead = units
            return
        head_unsure = self._lost_before > 0 or self._joining
        damaged = self._damaged or not complete or (head_unsure and form.lacks_its_head(units))
        self._joining = False
        self.units += 1
        self.units_damaged += damaged + self._units_lost()
        self._ready.append(
            ReceivedUnit(
                join_annex_b(self._with_parameters(units, kinds)),
                self._timestamp,
                not form.keys.isdisjoint(kinds),
                damaged,
                self._lost_before,
                self._first_received_ns,
                self._received_ns,
                form.codec,
                not form.leading.isdisjoint(kinds),
            )
        )

    def _units_lost(self) -> int:
        """How many pictures were lost whole before this one, by packets and timestamps."""
        before, self._newest = self._newest, self._timestamp
        step = 0 if before is None else serial_difference(self._timestamp - before)
        if step <= 0:
            return 0
        if not self._lost_before:
            self._period = min(self._period or step, step)
        missing = (step + self._period // 2) // self._period - 1 if self._period else 1
        return min(self._lost_before, missing)

    def _with_parameters(self, units: list[bytes], kinds: list[int]) -> list[bytes]:
        if self._form.sps in kinds:
            # The SDP may be older than the stream.
            self._parameter_sets = ()
        wanted = not (self._parameters_seen and self._form.keys.isdisjoint(kinds))
        self._parameters_seen = True
        return [*self._parameter_sets, *units] if wanted else units

    def next_event(self) -> ReceivedUnit | None:
        """Return the next access unit, or None until more packets come."""
        return self._ready.popleft() if self._ready else None

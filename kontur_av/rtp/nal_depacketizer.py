"""RTP packets to access units of H.264 and HEVC (RFC 6184, RFC 7798)."""

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from kontur_av.clock import NS_PER_MS
from kontur_av.errors import ProtocolError
from kontur_av.media import VideoCodec
from kontur_av.modular import serial_difference
from kontur_av.rtp.annex_b import join_annex_b
from kontur_av.rtp.nal_payload import Fragment, NalFormat

if TYPE_CHECKING:
    # `healing` needs `ReceivedUnit`, and must not load the rest of RTP.
    from kontur_av.rtp.receiver import RtpReceived

#: How long the first marked picture waits for a sign that it goes on behind its marker.
_MARKER_TRIED_NS = 40 * NS_PER_MS
#: How long a picture that no marker ends waits for its successor.
_UNMARKED_NS = 500 * NS_PER_MS
#: A packet without content, such as padding that keeps a path open.
_NOTHING = Fragment(())


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


@dataclass(slots=True)
class _Assembly:
    """An access unit whose packets come. parts: of a NAL unit. octets: of payload."""

    timestamp: int
    lost_before: int
    first_received_ns: int
    received_ns: int
    nal_units: list[bytes]
    octets: int
    parts: list[bytes] = field(default_factory=list)
    lost_within: int = 0
    has_picture: bool = False
    has_first: bool = False
    marked: bool = False
    damaged: bool = False
    too_large: bool = False


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
        ahead, self._ahead = self._ahead, []
        self._unit = _Assembly(
            timestamp,
            lost_before + self._lost_whole,
            received_ns,
            received_ns,
            ahead,
            sum(map(len, ahead)),
        )
        self._lost_whole = 0

    def handle_packet(self, packet: "RtpReceived") -> None:
        """Handle the next packet in sequence. Garbage is counted and never raises."""
        if packet.ssrc != self._source or packet.restart:
            if self._open:
                self._finish(complete=self._unit.marked or self._markers is False)
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
                self._unit.damaged = True
            return
        if not fragment.nal_units:
            self._lost_idle = lost
        elif fragment.is_part and not fragment.starts:
            if lost or not self._unit.parts or packet.timestamp != self._unit.timestamp:
                self._place(None, packet, lost)
            if self._unit.parts:
                self._unit.parts.append(fragment.nal_units[0])
            else:
                self._unit.damaged = True
        elif fragment.is_part:
            self._place(self._form.head(fragment.nal_units[0]), packet, lost)
            self._unit.parts.append(fragment.nal_units[0])
        for unit in () if fragment.is_part else fragment.nal_units:
            self._place(unit, packet, lost)
            self._unit.nal_units.append(unit)
            lost = 0
        if not self._open:
            return
        self._unit.received_ns = packet.received_ns
        self._unit.octets += len(packet.payload)
        if self._unit.octets > self._max_unit_octets:
            self._unit.too_large = True
            self._unit.nal_units.clear()
            self._unit.parts.clear()
        if fragment.is_part and fragment.ends:
            self._join_parts()
        if packet.marker:
            self._handle_marker()

    def _place(self, unit: bytes | None, packet: "RtpReceived", lost: int) -> None:
        """Prepare for a NAL unit, or its first part; None: for a later part of the present one."""
        form = self._form
        kind = -1 if unit is None else form.nal_type(unit)
        goes_on = unit is None or form.is_later_slice(unit)
        ended_first = self._ended_at is not None and self._unit.has_first
        if self._open:
            if self._unit.parts and unit is not None and not lost:
                # No packet is missing, so the sender forgot to mark the last part.
                self._join_parts()
            later = packet.timestamp != self._unit.timestamp
            # A sender may date each slice: a later one belongs to the first one before it.
            new = later and not (goes_on and self._unit.has_first)
            by_time = (later and lost) or (
                new and (self._unit.marked or not self._unit.has_picture)
            )
            by_content = not goes_on and (later or kind in form.slices or kind in form.beginners)
            if by_time or (by_content and self._unit.has_picture):
                # The next access unit starts.
                if (
                    self._markers is None
                    and self._unit.has_picture
                    and (self._unit.marked or not lost)
                ):
                    self._markers = self._unit.marked
                self._finish(complete=self._unit.marked or not lost)
        if not self._open:
            self._begin(packet.timestamp, lost, packet.received_ns)
            self._open = True
        elif lost:
            self._unit.lost_within += lost
            self._break_part()
            self._unit.damaged = True
        if goes_on:
            if self._ended_at == packet.timestamp or (ended_first and not lost):
                self._markers, self._unit.damaged = False, True
            elif self._unit.marked:
                self._markers = False
            self._unit.marked = False
        self._ended_at = None
        if kind in form.slices:
            self._unit.has_picture = True
            self._unit.has_first |= not goes_on

    def _join_parts(self) -> None:
        if self._unit.parts:
            # Start codes of Annex B inside the parts divide them into several NAL units.
            units = self._form.without_start_codes(b"".join(self._unit.parts))
            self._unit.parts.clear()
            self._unit.nal_units += units
            self._unit.has_picture |= any(
                self._form.nal_type(unit) in self._form.slices for unit in units
            )

    def _handle_marker(self) -> None:
        self._unit.marked = True
        if self._markers is not False or not self._unit.has_picture:
            self._join_parts()
        if self._markers or not self._unit.has_picture:
            self._ended_at = self._unit.timestamp if self._unit.has_picture else None
            self._finish(complete=True)

    def _break_part(self) -> None:
        if self._unit.parts:
            self._unit.damaged = True
            self._unit.parts.clear()

    def handle_timeout(self, now_ns: int) -> None:
        """End a picture that has waited long enough. Drain `next_event` afterwards."""
        due_ns = self.poll_timeout()
        if due_ns is not None and now_ns >= due_ns:
            if self._unit.marked and self._markers is None:
                self._markers = True
                self._ended_at = self._unit.timestamp
            self._join_parts()
            self._finish(complete=True)

    def poll_timeout(self) -> int | None:
        """Return when to call `handle_timeout`; None: not yet."""
        if not self._open or not self._unit.has_picture or self._markers:
            return None
        tried = self._unit.marked and self._markers is None
        return self._unit.received_ns + (_MARKER_TRIED_NS if tried else _UNMARKED_NS)

    def _finish(self, *, complete: bool) -> None:
        self._open = False
        self._break_part()
        if self._unit.too_large:
            self.garbage += 1
            self._lost_whole = max(self._unit.lost_before + self._unit.lost_within, 1)
            return
        units = self._unit.nal_units
        form = self._form
        kinds = [form.nal_type(unit) for unit in units]
        if form.slices.isdisjoint(kinds):
            # The next unit may be predicted from this one.
            self._lost_whole = self._unit.lost_before + self._unit.lost_within
            self._ahead = units
            return
        head_unsure = self._unit.lost_before > 0 or self._joining
        damaged = self._unit.damaged or not complete or (head_unsure and form.lacks_its_head(units))
        self._joining = False
        self.units += 1
        self.units_damaged += damaged + self._units_lost()
        self._ready.append(
            ReceivedUnit(
                join_annex_b(self._with_parameters(units, kinds)),
                self._unit.timestamp,
                not form.keys.isdisjoint(kinds),
                damaged,
                self._unit.lost_before,
                self._unit.first_received_ns,
                self._unit.received_ns,
                form.codec,
                not form.leading.isdisjoint(kinds),
            )
        )

    def _units_lost(self) -> int:
        """How many pictures were lost whole before this one, by packets and timestamps."""
        before, self._newest = self._newest, self._unit.timestamp
        step = 0 if before is None else serial_difference(self._unit.timestamp - before)
        if step <= 0:
            return 0
        if not self._unit.lost_before:
            self._period = min(self._period or step, step)
        missing = (step + self._period // 2) // self._period - 1 if self._period else 1
        return min(self._unit.lost_before, missing)

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

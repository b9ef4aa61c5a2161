"""Compresses RTP headers to one to four octets, correct under any loss: contexts and timing.

The receiver decompresses with the newest context that it holds. The sender knows all contexts that
this may be: the last one acknowledged, and all sent since then. It sends a compressed header only
if *each* of them restores exactly this header, by the receiver's own arithmetic (`rtp_forms`).
Otherwise the packet carries its whole header, raw or as a new context. No packet depends on the one
before, so a gap needs no recovery. No loss of packets or acknowledgements can corrupt a header.

docs/link-format.md says when contexts are sent, two-way and one-way, and for sources that do not
gain by them.
"""

from collections import deque
from typing import NamedTuple

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.modular import serial_difference
from telepresence.link.compression.rtp_forms import (
    CONTEXT_OCTETS,
    KIND_BARE,
    KIND_CONTEXT,
    KIND_LONG,
    KIND_NEAR,
    KIND_RAW,
    KIND_SHORT,
    KIND_WIDE,
    LARGEST_LEAD,
    LARGEST_PERIOD,
    LARGEST_RATE,
    PERIOD_PARTS,
    PLAIN_RTP,
    RATE_PARTS,
    RTP_HEADER,
    RTP_HEADER_OCTETS,
    Fields,
    HeaderContext,
    RtpForms,
    parse_context,
    residue_octets,
)
from telepresence.link.flows import Flow

#: Lifetime of a context that can be acknowledged. It exceeds any gap within a pass. It is bounded,
#: so that a wrapped frame count cannot revive a context.
LIFE_NS = 900 * NS_PER_S
#: Lifetime of a fleeting context: it covers a gap of 10 s, with a context lost just before the gap
#: and the next one due just after it.
FLEETING_LIFE_NS = 12_200 * NS_PER_MS
FLEETING_REFRESH_NS = NS_PER_S
#: Two-way, a context that still fits is renewed at this interval, to follow slow clock drift.
REFRESH_NS = 8 * NS_PER_S
#: A context that is not acknowledged is followed by another after this time, then after twice the
#: time, and so on.
RETRY_NS = 100 * NS_PER_MS
LONGEST_RETRY_NS = 3_200 * NS_PER_MS
#: Upper bound of an acknowledgement's delay. Contexts sent longer ago than this, and after the
#: acknowledged one, did not arrive.
ROUND_TRIP_NS = 30 * NS_PER_S
#: Largest number of contexts that the receiver may hold; with this many, no new one is sent.
MOST_POSSIBLE = 16
#: Number of whole headers after which a silent receiver is assumed to hold a context.
FIRST_WHOLE = 3
#: Tolerated distance of the sequence number from its prediction. It leaves room for the packets
#: sent before a new context is acknowledged.
_SEQUENCE_ERROR = 32
#: Octets of residue of each form, and of none.
_OCTETS = (0, 1, 1, 2, 3, 3)
#: Cost of a context over the raw header that it replaces; the tag is needed either way.
_CONTEXT_COST_OCTETS = CONTEXT_OCTETS - 2
_CANDIDATE_NS = NS_PER_S
#: Forms of headers in the report.
_NAMES = ("bare", "short", "near", "long", "wide", "context", "raw")
_NAME_OF = {
    KIND_WIDE: "wide",
    KIND_BARE: "bare",
    **dict.fromkeys(range(KIND_SHORT, KIND_NEAR), "short"),
    **dict.fromkeys(range(KIND_NEAR, KIND_LONG), "near"),
    **dict.fromkeys(range(KIND_LONG, 16), "long"),
}
#: Contexts may have cost this many octets more than they saved; what earlier ones saved counts up
#: to the same number. It suffices for the retries of the first second.
_TRUST_OCTETS = 4 * _CONTEXT_COST_OCTETS
#: After that, a context would have had to serve for this many packets in a row.
_REHEARSALS = 8


#: Rate assumed until two pictures have been seen.
_ASSUMED_HZ = 30
#: Largest number of grid points in the fit of the line.
_MEMORY = 256
#: Number of latest packets that determine the usual wait.
_WAITS = 64
#: One in this many waits is ignored as too long, and half as many as too short.
_OUTERMOST = 8
#: Two waits that differ by more than this part of a second mean that the source's clock jumped.
_JUMPS_PER_S = 2
#: A block of sound is at most 120 ms, so below this part of a second (RFC 6716 section 2.1.4).
_STRIDES_PER_S = 8
#: The packets a picture are counted over one to two times this number of pictures.
_PICTURES = 128
#: After this many pictures on a line, trust the line.
_STEADY = 16
#: Pictures needed to know a source that keeps its grid to the tick, and any other source.
_FEW, _MANY = 4, 32


class _Picture(NamedTuple):
    """A picture's number, and the sequence number and the timestamp of its first packet."""

    number: int
    sequence: int
    timestamp: int


class RtpSource:
    """One SSRC, packet by packet. A wrong estimate costs octets, but gives no wrong header.

    The grid is a line through the timestamps of the pictures, fitted by recursive least squares.
    Its memory grows up to `_MEMORY` pictures. At the k-th point the gains of such a filter are
    2(2k - 1) / (k(k + 1)) for the position and 6 / (k(k + 1)) for the slope. A flow with a known
    stride has a given grid, until its blocks have another length.

    index: number of the grid point nearest to the latest packet.
    """

    def __init__(self, flow: Flow, forms: RtpForms, sequence: int, timestamp: int) -> None:
        self._forms = forms
        self._stride = flow.stride_ticks
        self.index = 0
        self._grid_index = 0
        #: Timestamp and sequence number, not wrapped.
        self._timestamp = timestamp
        self._sequence = sequence
        self._grid = float(timestamp)
        self._period = float(self._stride or flow.clock_hz // _ASSUMED_HZ)
        self._points = 1
        # First packets of two pictures; the rate is measured from the older one.
        self._pictures = 0
        self._last_picture = _Picture(0, sequence, timestamp)
        self._marks = [self._last_picture, self._last_picture]
        # Pictures since the fit began, and the largest distance of one from the line.
        self._steady = 0
        self._worst = 0.0
        self._waits: deque[int] = deque(maxlen=_WAITS)
        self._jump = flow.clock_hz // _JUMPS_PER_S
        self._longest_stride = flow.clock_hz // _STRIDES_PER_S
        # The latest advance of a timestamp, and how often in a row it was the same.
        self._step = self._same_steps = 0

    def handle_packet(self, sequence: int, timestamp: int, count: int) -> None:
        """Take the next packet to send, and the frame count at which it starts."""
        self._sequence += serial_difference(sequence - self._sequence, 16)
        step = serial_difference(timestamp - self._timestamp)
        if step:
            self._timestamp += step
            self._handle_picture(step)
        wait = self._forms.slots_in_ticks(count) - self._timestamp
        waits = self._waits
        if waits and not -self._jump < wait - waits[-1] < self._jump:
            waits.clear()
        waits.append(wait)

    def _handle_picture(self, step: int) -> None:
        timestamp = self._timestamp
        self._pictures += 1
        self._last_picture = _Picture(self._pictures, self._sequence, timestamp)
        if self._pictures % _PICTURES == 0:
            self._marks = [self._marks[1], self._last_picture]
        if self._stride:
            self._follow_stride(step)
            self.index = self._grid_index = self.index + round(step / self._stride)
            self._grid = timestamp
            return
        if self._points == 1 and step > 0:
            self._period = float(step)
        periods = round((timestamp - self._grid) / self._period)
        error = timestamp - self._grid - periods * self._period
        self.index = self._grid_index + periods
        self._steady += 1
        self._worst = max(self._worst, abs(error))
        if abs(error) > self._period / 4 or (periods == 0 and step > 0):
            self._break()
            return
        if periods < 1:
            # A picture out of order (it refers to later ones) says nothing about the line.
            return
        self._points = points = min(self._points + 1, _MEMORY)
        scale = points * (points + 1)
        self._grid_index = self.index
        self._grid += periods * self._period + 2 * (2 * points - 1) / scale * error
        self._period += 6 / scale * error / periods

    def _follow_stride(self, step: int) -> None:
        """Take the blocks' length from the packets, if they have another than the flow's."""
        self._same_steps = self._same_steps + 1 if step == self._step else 1
        self._step = step
        if self._same_steps >= _FEW and 0 < step <= self._longest_stride:
            self._stride = step
            self._period = float(step)

    def _break(self) -> None:
        """Restart the fit: a pause, another rate, or a source without a grid."""
        self._steady, self._worst = 0, 0.0
        self._points = 1
        self._grid = float(self._timestamp)
        self._grid_index = self.index

    def _usual_wait(self) -> float:
        """Return the middle of the latest waits without the outermost: starts and stalls."""
        ordered = sorted(self._waits)
        if len(ordered) > 1:
            outermost = -(-len(ordered) // _OUTERMOST)
            ordered = ordered[outermost // 2 : -outermost]
        return (ordered[0] + ordered[-1]) / 2

    @property
    def known(self) -> bool:
        """Whether enough was seen for a context that serves for many seconds."""
        exact = self._steady >= _FEW and self._worst <= 1
        return exact or self._pictures >= _MANY or self._stride > 0

    def context(
        self, number: int, count: int, marker: int, payload_type: int, ssrc: int
    ) -> HeaderContext:
        """Return a context of the latest packet."""
        lead = round((self._waits[-1] - self._usual_wait()) / self._forms.lead_ticks)
        period, phase = self._period, round(self._grid) - self._timestamp
        index = self._grid_index
        pictures, sequences, ticks = (
            last - first for last, first in zip(self._last_picture, self._marks[0], strict=True)
        )
        if not self._stride and self._steady < _STEADY <= pictures and ticks > 0:
            # Without a grid, the mean distance still predicts the sequence number.
            period, phase = ticks / pictures, 0
            index = self.index
        rate = 1.0
        if not self._stride and ticks > 0:
            rate = sequences * period / ticks
            # Probably one packet a picture, with some pictures left out: then 1 is exact.
            if 7 / 8 <= rate <= 9 / 8:
                rate = 1.0
        return HeaderContext(
            number=number,
            count=count,
            marker=marker,
            payload_type=payload_type,
            sequence=self._sequence & 0xFFFF,
            timestamp=self._timestamp & 0xFFFF_FFFF,
            ssrc=ssrc,
            period=max(1, min(round(period * PERIOD_PARTS), LARGEST_PERIOD)),
            rate=max(0, min(round(rate * RATE_PARTS), LARGEST_RATE)),
            phase=phase if -0x8000 <= phase < 0x8000 else 0,
            index=index & 3,
            lead=max(-LARGEST_LEAD, min(lead, LARGEST_LEAD)),
        )


class RtpCompressor:
    """The sending end of one RTP flow. It begins one-way, with a peer that holds no context."""

    def __init__(self, flow: Flow, slot_ns: int) -> None:
        self._flow = flow
        self._forms = RtpForms(flow, slot_ns)
        #: Made with the first packet of each SSRC.
        self._source: RtpSource
        self._ssrc = -1
        #: Contexts that the receiver may hold, oldest first. See also `_may_hold_none`.
        self._possible: list[HeaderContext] = []
        self._acknowledged: HeaderContext | None = None
        #: The number acknowledged last; not reused while it may be acknowledged again.
        self._last_acknowledged = 0
        self._number = 0
        self._peer_heard = False
        self._whole_headers = 0
        self._sequence_error = 0
        # A context that was not sent, and the octets that it would have saved since the last one.
        self._candidate: HeaderContext | None = None
        self._missed_octets = 0
        #: Octets that contexts saved, less those that they cost; within `_TRUST_OCTETS`.
        self._balance = 0
        #: Packets in a row for which the candidate would have served.
        self._rehearsed = 0
        #: Slots from the latest acknowledged context to its acknowledgement.
        self._answer_delay = 0
        self._life, self._fleeting_life, self._round_trip, self._candidate_life = (
            ns // slot_ns for ns in (LIFE_NS, FLEETING_LIFE_NS, ROUND_TRIP_NS, _CANDIDATE_NS)
        )
        self._refresh, self._fleeting_refresh, self._retry, self._longest_retry = (
            ns // slot_ns for ns in (REFRESH_NS, FLEETING_REFRESH_NS, RETRY_NS, LONGEST_RETRY_NS)
        )
        self._kinds = dict.fromkeys(_NAMES, 0)
        self._header_octets = 0
        self._packets = 0

    def handle_peer(self, *, heard: bool) -> None:
        """Set whether the peer is heard from now on, and with it its acknowledgements."""
        self._peer_heard = heard

    def handle_acknowledgement(self, context_id: int, count: int) -> None:
        """The peer reported its newest context; 0: none, or a fleeting one.

        count: the present frame count of this end, not wrapped. Reports that refer to an earlier
        start of this end must not be passed on to this method.
        """
        self._last_acknowledged = context_id
        oldest = count - self._round_trip
        named = [context for context in self._possible if context.number == context_id]
        if not context_id or not named:
            self._acknowledged = None
            self._whole_headers = 0
            self._possible = [
                context
                for context in self._possible
                if context.number == 0 or context.count >= oldest
            ]
            return
        if self._acknowledged is not named[0]:
            self._answer_delay = count - named[0].count
        self._acknowledged = named[0]
        since = self._possible.index(named[0])
        newer = self._possible[since + 1 :]
        self._possible = named + [context for context in newer if context.count >= oldest]

    def forget(self) -> None:
        """The peer restarted: it may hold no context from before."""
        self._acknowledged = None
        self._last_acknowledged = 0
        self._whole_headers = 0

    def compress(self, data: bytes, count: int) -> tuple[int, bytes, int]:
        """Return the kind, the body, and how many octets of the body are header.

        data: an RTP packet. count: frame count, not wrapped, of the frame in which it starts.
        """
        self._packets += 1
        if len(data) < RTP_HEADER_OCTETS or data[0] != PLAIN_RTP:
            return self._raw(data)
        _, second, sequence, timestamp, ssrc = RTP_HEADER.unpack_from(data)
        if ssrc != self._ssrc:
            self._source = RtpSource(self._flow, self._forms, sequence, timestamp)
            self._ssrc = ssrc
            self._candidate, self._rehearsed = None, 0
        source = self._source
        source.handle_packet(sequence, timestamp, count)
        self._drop_expired(count)
        fields = (second >> 7, sequence, timestamp)
        payload_type = second & 0x7F
        header = None
        if not self._possible:
            self._whole_headers = 0
        elif not self._may_hold_none():
            header = self._header(payload_type, fields, count)
        if header is None and not self._trusted:
            self._rehearse(payload_type, fields, count)
        if not self._context_due(header, payload_type, fields, count):
            if header is None:
                return self._raw(data)
            kind, residue = header
            saved = RTP_HEADER_OCTETS - len(residue)
            self._balance = min(self._balance + saved, _TRUST_OCTETS)
            self._count_header(_NAME_OF[kind], len(residue))
            return kind, residue + data[RTP_HEADER_OCTETS:], len(residue)
        context = source.context(self._next_number(), count, fields[0], payload_type, ssrc)
        self._possible.append(context)
        self._candidate, self._missed_octets = context, 0
        self._balance = max(self._balance - _CONTEXT_COST_OCTETS, -_TRUST_OCTETS)
        self._rehearsed = 0
        self._whole_headers += 1
        self._count_header("context", CONTEXT_OCTETS)
        return KIND_CONTEXT, context.pack() + data[RTP_HEADER_OCTETS:], CONTEXT_OCTETS

    def _raw(self, data: bytes) -> tuple[int, bytes, int]:
        header_octets = min(len(data), RTP_HEADER_OCTETS)
        self._whole_headers += 1
        self._count_header("raw", header_octets)
        return KIND_RAW, data, header_octets

    def _drop_expired(self, count: int) -> None:
        oldest, oldest_fleeting = count - self._life, count - self._fleeting_life
        alive = [
            context
            for context in self._possible
            if context.count >= (oldest if context.number else oldest_fleeting)
        ]
        if len(alive) < len(self._possible):
            self._possible = alive
            if self._acknowledged not in alive:
                self._acknowledged = None

    def _may_hold_none(self) -> bool:
        return self._acknowledged is None and (
            self._peer_heard or self._whole_headers < FIRST_WHOLE
        )

    def _header(self, payload_type: int, fields: Fields, count: int) -> tuple[int, bytes] | None:
        """Return the shortest header (kind, residue) that each possible context restores."""
        possible, ssrc = self._possible, self._ssrc
        for context in possible:
            if context.ssrc != ssrc or context.payload_type != payload_type:
                return None
        forms, index = self._forms, self._source.index
        unpack = forms.unpack
        # The newest context says which form to try first; all contexts must then agree.
        first, self._sequence_error = forms.shortest(possible[-1], count, fields)
        for pack in forms.packers[first:]:
            kind, residue = pack(*fields, index)
            for context in possible:
                if unpack(kind, residue, context, count) != fields:
                    break
            else:
                return kind, residue
        return None

    def _context_due(
        self, header: tuple[int, bytes] | None, payload_type: int, fields: Fields, count: int
    ) -> bool:
        possible = self._possible
        if not self._trusted and self._rehearsed < _REHEARSALS:
            return False
        if not self._peer_heard and not self._source.known:
            # Without acknowledgements a bad context would serve for its whole lifetime.
            return False
        if not possible:
            return True
        newest = possible[-1]
        age = count - newest.count
        if age < self._retry or len(possible) >= MOST_POSSIBLE:
            return False
        if not self._peer_heard:
            if age >= self._fleeting_refresh:
                return True
            # While older ones may be held, a new one helps only if they are all of another kind.
            return header is None and not self._serves(newest, payload_type, fields, count)
        pending = sum(1 for context in possible if context.number)
        if self._acknowledged is not None:
            pending -= 1
        if age >= (self._longest_retry if pending else self._refresh):
            return True
        if age < self._retry << max(0, pending - 1):
            return False
        if header is None:
            return True
        if abs(self._sequence_error) > _SEQUENCE_ERROR:
            return True
        return not pending and self._renewal_pays(len(header[1]), payload_type, fields, count)

    @property
    def _trusted(self) -> bool:
        """Whether the latest contexts have saved enough, so that another one may be sent."""
        return self._balance > -_TRUST_OCTETS

    def _rehearse(self, payload_type: int, fields: Fields, count: int) -> None:
        """Count for how many packets in a row a context would have served if it had been sent."""
        candidate = self._candidate
        age = 0 if candidate is None else count - candidate.count
        if candidate is not None and not self._serves(candidate, payload_type, fields, count):
            self._rehearsed = 0
        elif age >= self._answer_delay:
            # Before, it would not have been acknowledged.
            self._rehearsed += 1
        if candidate is None or age >= self._answer_delay + self._candidate_life:
            self._candidate = self._source.context(0, count, fields[0], payload_type, self._ssrc)

    def _serves(
        self, context: HeaderContext, payload_type: int, fields: Fields, count: int
    ) -> bool:
        if context.ssrc != self._ssrc or context.payload_type != payload_type:
            return False
        return self._forms.shortest(context, count, fields)[0] < len(self._forms.packers)

    def _renewal_pays(self, octets: int, payload_type: int, fields: Fields, count: int) -> bool:
        """Whether the lack of a newer context has cost as many octets as one costs (ski rental)."""
        candidate = self._candidate
        gain = 0
        if candidate is not None and octets:
            first, _ = self._forms.shortest(candidate, count, fields)
            gain = octets - _OCTETS[first]
            self._missed_octets = max(0, self._missed_octets + gain)
        # One that needs as much is replaced soon: the source may just have changed.
        life = self._candidate_life if gain > 0 or octets < 2 else self._retry
        if candidate is None or count - candidate.count >= life:
            self._candidate = self._source.context(0, count, fields[0], payload_type, self._ssrc)
            if gain <= 0 and octets >= 2:
                self._missed_octets = 0
        return self._missed_octets >= _CONTEXT_COST_OCTETS

    def _next_number(self) -> int:
        """0 while the peer is not heard, else a number that no other possible context has."""
        if not self._peer_heard:
            return 0
        taken = {context.number for context in self._possible} | {0, self._last_acknowledged}
        while (self._number & 0xFF) in taken:
            self._number += 1
        number = self._number & 0xFF
        self._number += 1
        return number

    def _count_header(self, name: str, header_octets: int) -> None:
        self._kinds[name] += 1
        self._header_octets += 1 + header_octets

    def report(self) -> dict[str, int]:
        """Return packets by kind of header, all packets, and the octets of headers with tags."""
        return {**self._kinds, "packets": self._packets, "header_octets": self._header_octets}


class RtpDecompressor:
    """The receiving end of one RTP flow. It holds one context, the newest.

    context_id: number to acknowledge; 0 for no context or a fleeting one.
    """

    def __init__(self, flow: Flow, slot_ns: int) -> None:
        self._unpack = RtpForms(flow, slot_ns).unpack
        self._life, self._fleeting_life = LIFE_NS // slot_ns, FLEETING_LIFE_NS // slot_ns
        self._context: HeaderContext | None = None
        self.context_id = 0

    def forget(self) -> None:
        """The peer restarted: discard what it sent before."""
        self._context = None
        self.context_id = 0

    def decompress(self, kind: int, body: bytes, count: int) -> bytes | str:
        """Return the RTP packet, or in one word the reason why there is none.

        count: frame count, not wrapped, of the frame in which the packet started.
        """
        if kind >= KIND_WIDE:
            context = self._context
            if context is None:
                return "no_context"
            life = self._life if context.number else self._fleeting_life
            if count - context.count > life:
                return "no_context"
            fields = self._unpack(kind, body, context, count)
            if fields is None:
                return "malformed"
            marker, sequence, timestamp = fields
            second = marker << 7 | context.payload_type
            header = RTP_HEADER.pack(PLAIN_RTP, second, sequence, timestamp, context.ssrc)
            return header + body[residue_octets(kind) :]
        if kind == KIND_RAW:
            return body
        if kind != KIND_CONTEXT:
            return "malformed"
        context = parse_context(body, count)
        if context is None:
            return "malformed"
        self._context = context
        self.context_id = context.number
        second = context.marker << 7 | context.payload_type
        header = RTP_HEADER.pack(
            PLAIN_RTP, second, context.sequence, context.timestamp, context.ssrc
        )
        return header + body[CONTEXT_OCTETS:]

"""The sending end: one frame a slot with the newest sample, filled by priority of the levels."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from telepresence.haptics.mediated.wall import is_wall
from telepresence.link.flows import Flow, FlowKind, Level, check_flows
from telepresence.link.frame import (
    CLOSED,
    KIND_SHIFT,
    LARGEST_SHORT_LENGTH,
    LONG_LENGTH,
    MAX_PACKET_OCTETS,
    TAG_FILL,
    TAG_PAD,
    TAG_RESUME,
    FrameCodec,
    Pointers,
)
from telepresence.link.header_compression import KIND_WHOLE, RtpCompressor
from telepresence.link.link_metrics import RepairSentMetrics, SenderMetrics
from telepresence.link.profile import FECF_OCTETS, HEADER_OCTETS, SUPERVISION_OCTETS, LinkProfile
from telepresence.link.queues import DEFAULT_LIMITS, PacketQueue, QueueLimits
from telepresence.link.repair.encoder import RepairEncoder
from telepresence.link.repair.reserve import NOTHING
from telepresence.tmtc.pus.head import is_packet

#: Largest number of packets of which a slot sends a part. It bounds the work of a slot at both
#: ends; packets of six octets or more fill the largest zone with fewer.
MOST_PIECES = 64


@dataclass(slots=True)
class _InFlight:
    """A packet of which a part was sent. Its body is header and payload as on the link."""

    tag: int
    body: bytes
    header_octets: int
    level: int
    kind: str
    #: It is the last of a picture.
    marker: bool
    offset: int = 0


class LinkSender:
    """Takes packets and haptic samples; returns exactly one transfer frame for each slot.

    Call `poll_transmit` once a slot and send what it returns. Priority is strict: a packet of a
    higher level goes into the next frame and may interrupt one of a lower level.

    profile, flows: the direction and its flow table, as at the other end.
    limits: queue limits by level, where they differ from the defaults.
    first_count: frame count of the first frame.

    repair: fills idle zones; None: they stay idle.
    reserve: the slots that are kept for repair.
    """

    def __init__(
        self,
        profile: LinkProfile,
        flows: Sequence[Flow],
        *,
        limits: Mapping[Level, QueueLimits] | None = None,
        first_count: int = 0,
    ) -> None:
        self.profile = profile
        self.flows = check_flows(flows)
        self._codec = FrameCodec(profile)
        self._pointers = Pointers(profile)
        self._sample_zone_octets = profile.packet_zone_octets
        self._plain_zone_octets = profile.largest_zone_octets
        limits = {**DEFAULT_LIMITS, **(limits or {})}
        self._queues = [PacketQueue(limits[level]) for level in Level]
        #: Levels whose rate is limited.
        self._limited = [level for level in Level if limits[level].rate_bps is not None]
        #: Nothing is queued or in flight, so a slot needs no search. True in most slots.
        self._nothing_queued = True
        self._numbers = {flow.name: number for number, flow in enumerate(self.flows)}
        self._kinds = [
            "rtcp" if flow.kind is FlowKind.RTCP else flow.level.name.lower() for flow in self.flows
        ]
        self._rtcp = [flow.kind is FlowKind.RTCP for flow in self.flows]
        self._compressors = [
            RtpCompressor(flow, profile.slot_ns) if flow.kind is FlowKind.RTP else None
            for flow in self.flows
        ]
        self._first_count = first_count
        self._count = first_count
        self._insert_octets = profile.insert_octets
        self._sample: bytes | None = None
        self._on_air: _InFlight | None = None
        self._waiting: list[_InFlight | None] = [None] * len(Level)
        #: The packet on air was dropped, and the receiver must not take it for complete.
        self._on_air_dropped = False
        self.haptic_sent = 0
        self.haptic_superseded = 0
        self.supervision_sent = 0
        self.refused = {"garbage": 0, "oversize": 0, "haptic_length": 0}
        levels = (level.name.lower() for level in Level)
        self._carried = dict.fromkeys((*levels, "rtcp", "packet_headers", "framing"), 0)
        self._idle = 0
        self.repair: RepairEncoder | None = None
        self.set_repair(True)
        self._repair_octets = 0
        #: Only the next zone's pointer tells that the packet in flight ended with the last zone.
        self._end_untold = False
        self.reserve = NOTHING
        #: Packets of the lowest level wait, but for one that has begun.
        self.holds_maintenance = False
        #: Repair zones that the reserve still asks for.
        self._owed = 0

    def set_repair(self, on: bool) -> None:
        """Whether idle slots carry repair zones, where the profile has repair."""
        self.repair = RepairEncoder(self.profile) if on and self.profile.repair != "off" else None

    def handle_haptic(self, sample: bytes, now_ns: int) -> bool:
        """Set the newest sample of exactly `insert_octets`; it replaces one not sent yet.

        Return False, and count it, if the length is wrong.
        """
        if len(sample) != self._insert_octets:
            self.refused["haptic_length"] += 1
            return False
        if self._sample is not None:
            self.haptic_superseded += 1
        self._sample = sample
        return True

    def handle_packet(self, flow: str, data: bytes, now_ns: int) -> bool:
        """Queue the payload of a datagram of `flow`; return False, and count it, if refused.

        A flow of RTP, RTCP (RFC 3550) or TM/TC refuses what cannot be such a packet, because
        garbage must not take capacity from media. Raises KeyError for an unknown flow.
        """
        number = self._numbers[flow]
        if len(data) > MAX_PACKET_OCTETS:
            self.refused["oversize"] += 1
            return False
        known = self.flows[number]
        if known.kind is not FlowKind.RAW and not _plausible(known.kind, data):
            self.refused["garbage"] += 1
            return False
        self._nothing_queued = False
        queue = self._queues[known.level]
        return queue.handle_packet(number, data, now_ns, rtcp=self._rtcp[number])

    def queue(self, level: Level) -> PacketQueue:
        """The queue of `level`, read-only: its packets were not sent yet, not even in part."""
        return self._queues[level]

    def waiting_octets(self, level: Level) -> int:
        """Octets of the level's packets of which nothing was sent yet, as the queue counts them."""
        return self._queues[level].octets

    def begun_octets(self, level: Level) -> int:
        """Octets that are left of packets partly sent, of this level and those above it."""
        packets = [*self._waiting[: level + 1], self._on_air]
        return sum(
            len(packet.body) - packet.offset
            for packet in packets
            if packet is not None and packet.level <= level
        )

    def flush(self, now_ns: int) -> None:
        """The signal is lost: drop all packets that wait or are partly sent.

        They are counted as `signal_lost`. The sample stays, because it is never older than a slot.
        """
        on_air, self._on_air = self._on_air, None
        self._on_air_dropped = self._on_air_dropped or on_air is not None
        for level, queue in enumerate(self._queues):
            self._waiting[level] = None
            queue.flush(now_ns)

    def set_timeout(self, max_age_ns: int | None) -> None:
        """Limit the age of all packets; older ones are dropped as `signal_lost`."""
        for queue in self._queues:
            queue.set_timeout(max_age_ns)

    def restart_contexts(self) -> None:
        """The peer may hold no header context: begin all RTP flows with whole headers."""
        for compressor in self._compressors:
            if compressor is not None:
                compressor.restart()

    def poll_transmit(self, now_ns: int, supervision: bytes | None = None) -> bytes:
        """Return the frame of this slot: `profile.frame_octets` octets, idle if nothing waits.

        supervision: twelve octets that take this slot's packet zone; packets continue afterwards.
        """
        sample = self._sample
        if sample is not None:
            self._sample = None
            self.haptic_sent += 1
            size = self._sample_zone_octets
        else:
            size = self._plain_zone_octets
        count, repair = self._count, self.repair
        content, untold, repaired = None, self._end_untold, None
        if supervision is not None:
            if len(supervision) != SUPERVISION_OCTETS:
                raise ValueError(f"a supervision message has {SUPERVISION_OCTETS} octets")
            self.supervision_sent += 1
            self._idle += size - SUPERVISION_OCTETS
            content = self._pointers.supervision, supervision.ljust(size, b"\0")
        elif not self._nothing_queued:
            if repair is not None and self._owed and self._may_reserve():
                repaired = repair.repair(count, plain=sample is None, reserved=True)
            if repaired is None:
                self._end_untold = False
                content = self._fill_zone(size, now_ns)
        self._count = count + 1
        if repair is not None:
            if content is not None:
                repair.protect(count, *content)
            elif repaired is None and not untold and (repair.credit or repair.new):
                repaired = repair.repair(count, plain=sample is None)
            if repaired is not None:
                self._owed = max(0, self._owed - 1)
                self._repair_octets += size
                return self._codec.pack(count, sample, *repaired)
        if content is not None:
            return self._codec.pack(count, sample, *content)
        self._end_untold = False
        self._idle += size
        return self._codec.pack_idle(count, sample)

    def _may_reserve(self) -> bool:
        """Whether a repair zone may go before what waits: only before video and maintenance."""
        on_air, queues = self._on_air, self._queues
        urgent = (Level.TMTC, Level.VOICE)
        return not (
            self._end_untold
            or (on_air is not None and on_air.level in urgent)
            or any(queues[level].octets or self._waiting[level] for level in urgent)
        )

    def _fill_zone(self, size: int, now_ns: int) -> tuple[int, bytes] | None:
        """Return the first header pointer and a packet zone of `size` octets; None: it is idle."""
        pointers = self._pointers
        queues, packet = self._queues, self._on_air
        parts: list[bytes] = []
        position = 0
        pointer = 0
        if packet is not None and not queues[packet.level].continues(now_ns):
            packet = self._on_air = None
            self._on_air_dropped = True
        if packet is not None:
            remaining = len(packet.body) - packet.offset
            if any(queues[n].octets and queues[n].waiting(now_ns) for n in range(packet.level)) or (
                size != self._sample_zone_octets
                and self.repair is not None
                and remaining < self.repair.least_position
            ):
                pointer = pointers.preempt
                self._waiting[packet.level] = packet
            else:
                if remaining > size:
                    return pointers.no_start, self._piece(packet, size)
                self._finish(packet, now_ns)
                if remaining == size:
                    self._on_air = None
                    # A restored zone does not tell it.
                    self._end_untold = True
                    return size, self._piece(packet, size)
                parts.append(self._piece(packet, remaining))
                pointer = position = remaining
            self._on_air = None
        elif self._on_air_dropped:
            # The receiver still waits for the dropped packet; the next one of its level ends that.
            self._on_air_dropped = False
            pointer = pointers.preempt
        while position < size:
            rest = size - position
            packet = self._next_packet(now_ns) if len(parts) < MOST_PIECES else None
            if packet is None:
                # Packets remain if there are too many for the work of one slot.
                left = any(self._waiting) or any(queue.octets for queue in queues)
                self._nothing_queued = not left
                if not position and not pointer:
                    return None
                self._idle += rest
                parts.append(bytes((TAG_FILL,)) + bytes(rest - 1))
                break
            parts.append(self._segment(packet, rest, now_ns))
            position += len(parts[-1])
        return pointer, b"".join(parts)

    def _segment(self, packet: _InFlight, rest: int, now_ns: int) -> bytes:
        """Return a tag and as much of the packet as fits into the remaining zone."""
        remaining = len(packet.body) - packet.offset
        key = "packet_headers" if packet.tag >> KIND_SHIFT else "framing"
        if remaining >= rest - 1:
            self._carried[key] += 1
            segment = bytes((packet.tag,)) + self._piece(packet, rest - 1)
            if remaining >= rest:
                self._on_air = packet
                packet.tag = TAG_RESUME + packet.level
            else:
                self._finish(packet, now_ns)
                self._end_untold = True
            # The next frame's pointer shows that the packet ended with this zone.
            return segment
        short = remaining <= LARGEST_SHORT_LENGTH
        if not short and remaining + 3 > rest:
            # Too short to fill the zone, too long with its two length octets: insert a pad octet.
            self._carried["framing"] += 1
            self._waiting[packet.level] = packet
            return bytes((TAG_PAD,))
        self._finish(packet, now_ns)
        self._carried[key] += 1
        tag = packet.tag | CLOSED
        if short:
            self._carried["framing"] += 1
            return bytes((tag, remaining)) + self._piece(packet, remaining)
        self._carried["framing"] += 2
        head = bytes((tag,)) + (LONG_LENGTH | remaining).to_bytes(2, "big")
        return head + self._piece(packet, remaining)

    def _finish(self, packet: _InFlight, now_ns: int) -> None:
        """The packet's last piece is in this slot."""
        self._queues[packet.level].finish(now_ns)
        if packet.kind == "voice":
            self._owed = max(self._owed, self.reserve.after_voice)
        elif packet.marker:
            self._owed = max(self._owed, self.reserve.after_picture)

    def _piece(self, packet: _InFlight, octets: int) -> bytes:
        """Return the next `octets` of the packet, and count them by what they carry."""
        offset = packet.offset
        packet.offset = end = offset + octets
        header = packet.header_octets
        carried = self._carried
        if offset < header:
            of_header = min(end, header) - offset
            carried["packet_headers"] += of_header
            octets -= of_header
        carried[packet.kind] += octets
        return packet.body[offset:end]

    def _next_packet(self, now_ns: int) -> _InFlight | None:
        """Return the next packet by priority; one begun before goes first in its level."""
        waiting, queues = self._waiting, self._queues
        for level, queue in enumerate(queues):
            begun = waiting[level]
            if begun is not None:
                waiting[level] = None
                if queue.continues(now_ns):
                    return begun
            if level == Level.MAINTENANCE and self.holds_maintenance:
                return None
            if queue.octets and queue.waiting(now_ns):
                return self._begin(level, now_ns)
        for level in self._limited:
            # Nothing else waits, so what exceeds the rate costs nobody anything.
            if queues[level].octets and queues[level].held(now_ns):
                return self._begin(level, now_ns)
        return None

    def _begin(self, level: int, now_ns: int) -> _InFlight:
        number, data = self._queues[level].take(now_ns)
        compressor = self._compressors[number]
        if compressor is None:
            kind, body, header_octets = KIND_WHOLE, data, 0
        else:
            kind, body, header_octets = compressor.compress(data, self._count)
        tag = kind << KIND_SHIFT | number
        marker = compressor is not None and level == Level.VIDEO and data[1] >= 0x80
        return _InFlight(tag, body, header_octets, level, self._kinds[number], marker)

    @property
    def idle_octets(self) -> int:
        """Octets of packet zones that carried no packets, repair included."""
        return self._idle + self._repair_octets

    @property
    def frames_sent(self) -> int:
        return self._count - self._first_count

    def octets(self) -> dict[str, int]:
        """Octets of all frames by what they carried; the sum is exactly frame_octets * frames.

        packet_headers: tags and RTP headers, compressed or whole. framing: M_PDU headers, lengths,
        pads and resume tags. idle: fill, and the rest of supervision slots. repair: whole zones,
        where the profile has repair.
        """
        frames, carried = self.frames_sent, self._carried
        return {
            "header": frames * HEADER_OCTETS,
            "fecf": frames * FECF_OCTETS,
            "haptic": self.haptic_sent * self._insert_octets,
            **carried,
            "framing": carried["framing"] + frames * self.profile.mpdu_octets,
            "supervision": self.supervision_sent * SUPERVISION_OCTETS,
            "idle": self._idle,
            **({} if self.profile.repair == "off" else {"repair": self._repair_octets}),
        }

    def report(self, now_ns: int, repair: RepairSentMetrics | None = None) -> SenderMetrics:
        """Return rates, the octets by what they carried, and each level's queue."""
        return SenderMetrics(
            capacity_bps=self.profile.capacity_bps,
            frames=self.frames_sent,
            octets=self.octets(),
            queue={level.name.lower(): self._queues[level].report(now_ns) for level in Level},
            haptic_sent=self.haptic_sent,
            haptic_superseded=self.haptic_superseded,
            headers={
                flow.name: compressor.report()
                for flow, compressor in zip(self.flows, self._compressors, strict=True)
                if compressor is not None
            },
            refused=dict(self.refused),
            repair_sent=repair,
        )


def _plausible(kind: FlowKind, data: bytes) -> bool:
    """Whether `data` can be a packet of `kind`, by RFC 3550, or of PUS, or a wall."""
    if kind is FlowKind.TMTC:
        return is_wall(data) or is_packet(data)
    if kind is FlowKind.RTP:
        return len(data) >= 12 and data[0] >> 6 == 2
    return len(data) >= 8 and data[0] >> 6 == 2 and 192 <= data[1] <= 223

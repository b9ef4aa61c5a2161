"""The receiving end: whole packets and samples from frames; losses never join two packets."""

from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

from kontur_av.clock import NS_PER_S
from telepresence.link.compression.header_compression import RtpDecompressor
from telepresence.link.compression.rtp_forms import KIND_CONTEXT, KIND_RAW
from telepresence.link.figures import ReceiverFigures
from telepresence.link.flows import MAX_FLOWS, Flow, FlowKind, Level, check_flows
from telepresence.link.frame import (
    CLOSED,
    COUNT_MASK,
    COUNT_MODULUS,
    KIND_BITS,
    KIND_SHIFT,
    LARGEST_SHORT_LENGTH,
    MAX_PACKET_OCTETS,
    NUMBER_MASK,
    TAG_FILL,
    TAG_PAD,
    TAG_RESUME,
    FrameCodec,
    Pointers,
)
from telepresence.link.profile import SUPERVISION_OCTETS, LinkProfile

#: A frame at most this far behind is late or repeated; one farther behind is from a new life.
_LATE_FRAMES = 32
#: After this many late frames in a row, assume that the peer restarted with a slightly lower count.
_LATE_RUN = 4
#: After this many implausible frame counts in a row, assume a new life of the peer. A single one is
#: more likely a bit error that the FECF did not detect.
_STRAY_RUN = 2

_new_event = tuple.__new__

#: The level that each control code resumes; -1 for undefined codes.
_RESUMED = [-1] * TAG_RESUME + [*range(len(Level))]


class HapticReceived(NamedTuple):
    """One sample from an insert zone."""

    sample: bytes
    now_ns: int


class PacketReceived(NamedTuple):
    """One packet: exactly the UDP payload that entered at the other end of `flow`."""

    flow: Flow
    data: bytes
    now_ns: int


class SupervisionReceived(NamedTuple):
    """One supervision message of twelve octets, which the receiver does not parse."""

    message: bytes
    now_ns: int


LinkEvent = HapticReceived | PacketReceived | SupervisionReceived


class _Partial:
    """A packet whose end has not arrived yet."""

    __slots__ = ("body", "count", "tag")

    def __init__(self, tag: int, count: int, body: bytes) -> None:
        self.tag = tag
        self.count = count
        self.body = bytearray(body)


class LinkReceiver:
    """Takes frames by `handle_frame`; returns samples, packets and messages by `next_event`.

    It never raises because of data from the peer; invalid data is counted by reason and dropped.

    profile, flows: the direction and its flow table, as at the other end.
    deliver: while False, samples and packets are dropped and counted as `unapproved`.
    """

    def __init__(self, profile: LinkProfile, flows: Sequence[Flow]) -> None:
        self.profile = profile
        self.flows = check_flows(flows)
        self.deliver = True
        self._parse = FrameCodec(profile).parse
        self._pointers = Pointers(profile)
        self._idle = self._pointers.idle
        self._no_start = self._pointers.no_start
        self._decompressors = [
            RtpDecompressor(flow, profile.slot_ns) if flow.kind is FlowKind.RTP else None
            for flow in self.flows
        ]
        self._levels = [int(flow.level) for flow in self.flows]
        self._levels += [-1] * (MAX_FLOWS - len(self.flows))
        self._context_ids = (0,) * sum(item is not None for item in self._decompressors)
        #: The events of `next_event`, oldest first.
        self.events: deque[LinkEvent] = deque()
        self._partials: list[_Partial | None] = [None] * len(Level)
        self._on_air: int | None = None
        #: The last frame's count, without the wraps of its 24 bits; -1 before the first.
        self._count = -1
        self._next24 = -1
        self._last_ns = 0
        #: The latest run of late or stray frames: the last good frame's count, the next count of
        #: the run, and its length.
        self._unexpected_run = (-1, -1, 0)
        self.frames_received = 0
        self.frames_lost = 0
        self.restarts = 0
        #: Number of lives of the peer so far.
        self.meetings = 0
        self.haptic_received = 0
        self.haptic_unapproved = 0
        self.supervision_received = 0
        self.frames_dropped: dict[str, int] = {}
        self.packets_dropped: dict[str, int] = {}
        self.packets_received = [0] * len(self.flows)

    def handle_frame(self, frame: bytes, now_ns: int) -> bool:
        """Take a frame from the radio; return whether it is a good frame of a live peer.

        Drain `next_event` afterwards.
        """
        parsed = self._parse(frame)
        if isinstance(parsed, str):
            self._drop_frame(parsed)
            return False
        count24, sample, pointer, zone = parsed
        if count24 == self._next24:
            self._count += 1
        elif not self._follow(count24, now_ns):
            return False
        self._next24 = count24 + 1 & COUNT_MASK
        self._last_ns = now_ns
        self.frames_received += 1
        if sample is not None:
            if self.deliver:
                self.haptic_received += 1
                # This skips the NamedTuple's own `__new__`, once a millisecond.
                self.events.append(_new_event(HapticReceived, (sample, now_ns)))
            else:
                self.haptic_unapproved += 1
        on_air = self._on_air
        if pointer == self._idle:
            if on_air is not None:
                self._finish(on_air, now_ns)
        elif pointer == self._no_start:
            if on_air is not None:
                self._extend(on_air, zone)
        else:
            self._handle_zone(pointer, zone, now_ns)
        return True

    def handle_signal_lost(self, now_ns: int) -> None:
        """The signal is lost: drop incomplete packets, which would not be completed in time."""
        self._drop_partials()

    def context_ids(self) -> tuple[int, ...]:
        """The newest context held of each RTP flow, in the table's order; 0 for none."""
        return self._context_ids

    def forget_contexts(self) -> None:
        """Forget all contexts: the peer began a new life.

        The frame count does not always show that. The new contexts reuse the numbers of the old
        ones, so no old one may be reported as held.
        """
        for decompressor in self._decompressors:
            if decompressor is not None:
                decompressor.forget()
        self._note_contexts()

    def next_event(self) -> LinkEvent | None:
        """The next event in the order of reception, or None. Call until None."""
        return self.events.popleft() if self.events else None

    def _follow(self, count24: int, now_ns: int) -> bool:
        """Handle a frame count that is not the next one; return whether to use the frame."""
        last = self._count
        if last < 0:
            self.meetings = 1
            self._count = count24
        else:
            ahead = count24 - last & COUNT_MASK
            late = ahead == 0 or COUNT_MODULUS - ahead < _LATE_FRAMES
            if late or (count24 and not self._plausible(ahead, now_ns)):
                continues = self._unexpected_run[:2] == (last, count24)
                run = self._unexpected_run[2] + 1 if continues else 1
                self._unexpected_run = last, count24 + 1, run
                if ahead == 0 or run < (_LATE_RUN if late else _STRAY_RUN):
                    self._drop_frame("late" if late else "stray")
                    return False
                self._restart(count24)
            elif count24 == 0:
                # A sender without `first_count` begins at 0 after a restart.
                self._restart(count24)
            else:
                self.frames_lost += ahead - 1
                self._drop_partials()
                self._count = last + ahead
        return True

    def _plausible(self, ahead: int, now_ns: int) -> bool:
        """Whether enough time for `ahead` slots has passed since the last frame."""
        elapsed_ns = now_ns - self._last_ns
        return ahead * self.profile.slot_ns <= 2 * elapsed_ns + NS_PER_S

    def _restart(self, count24: int) -> None:
        self.restarts += 1
        self.meetings += 1
        self._drop_partials()
        self.forget_contexts()
        self._count = count24

    def _note_contexts(self) -> None:
        self._context_ids = tuple(
            decompressor.context_id
            for decompressor in self._decompressors
            if decompressor is not None
        )

    def _drop_partials(self) -> None:
        for level, partial in enumerate(self._partials):
            if partial is not None:
                self._partials[level] = None
                self._drop_packet("incomplete")
        self._on_air = None

    def _drop_frame(self, reason: str) -> None:
        self.frames_dropped[reason] = self.frames_dropped.get(reason, 0) + 1

    def _drop_packet(self, reason: str) -> None:
        self.packets_dropped[reason] = self.packets_dropped.get(reason, 0) + 1

    def _malformed(self) -> None:
        """The peer violates the tag format, so drop everything in progress."""
        self._drop_packet("malformed")
        self._drop_partials()

    def _extend(self, level: int, piece: bytes) -> None:
        partial = self._partials[level]
        if partial is None:
            return
        partial.body += piece
        if len(partial.body) > MAX_PACKET_OCTETS + 16:
            self._partials[level] = None
            self._on_air = None
            self._drop_packet("oversize")

    def _finish(self, level: int | None, now_ns: int) -> None:
        """The packet of `level` is complete."""
        self._on_air = None
        if level is None:
            return
        partial = self._partials[level]
        self._partials[level] = None
        if partial is not None:
            self._deliver(partial.tag, partial.count, bytes(partial.body), now_ns)

    def _handle_zone(self, pointer: int, zone: bytes, now_ns: int) -> None:
        """Handle a zone in which a packet begins or ends, or with a supervision message."""
        on_air, pointers = self._on_air, self._pointers
        if pointer == pointers.supervision:
            self.supervision_received += 1
            self.events.append(SupervisionReceived(zone[:SUPERVISION_OCTETS], now_ns))
        elif pointer == pointers.preempt:
            self._parse_tags(zone, 0, now_ns)
        elif pointer > len(zone):
            self._malformed()
        else:
            if on_air is not None:
                self._extend(on_air, zone[:pointer])
                self._finish(self._on_air, now_ns)
            self._parse_tags(zone, pointer, now_ns)

    def _parse_tags(self, zone: bytes, position: int, now_ns: int) -> None:
        size = len(zone)
        self._on_air = None
        while position < size:
            tag = zone[position]
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
                    self._drop_packet("incomplete")
                if tag & CLOSED:
                    self._deliver(tag & ~CLOSED, self._count, piece, now_ns)
                else:
                    self._partials[level] = _Partial(tag, self._count, piece)
                    self._on_air = level
                continue
            self._extend(level, piece)
            if tag & CLOSED:
                self._finish(level, now_ns)
            else:
                self._on_air = level

    def _deliver(self, tag: int, count: int, body: bytes, now_ns: int) -> None:
        number, kind = tag & NUMBER_MASK, tag >> KIND_SHIFT
        decompressor = self._decompressors[number]
        packet: bytes | str
        if decompressor is not None:
            packet = decompressor.decompress(kind, body, count)
            if kind == KIND_CONTEXT:
                self._note_contexts()
            if isinstance(packet, str):
                self._drop_packet(packet)
                return
        elif kind == KIND_RAW:
            packet = body
        else:
            self._drop_packet("malformed")
            return
        if self.deliver:
            self.packets_received[number] += 1
            self.events.append(PacketReceived(self.flows[number], packet, now_ns))
        else:
            self._drop_packet("unapproved")

    def report(self) -> ReceiverFigures:
        """Return frames, samples and packets: received, lost, and dropped by reason."""
        return ReceiverFigures(
            name=self.profile.name,
            frames=self.frames_received,
            frames_lost=self.frames_lost,
            frames_dropped=dict(self.frames_dropped),
            restarts=self.restarts,
            haptic_received=self.haptic_received,
            haptic_unapproved=self.haptic_unapproved,
            supervision_received=self.supervision_received,
            packets={
                flow.name: received
                for flow, received in zip(self.flows, self.packets_received, strict=True)
            },
            packets_dropped=dict(self.packets_dropped),
        )

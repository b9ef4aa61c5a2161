"""The receiving end: whole packets and samples out of frames, and nothing spliced after a loss."""

from collections import deque
from collections.abc import Sequence
from typing import Any, NamedTuple

from kontur_av.clock import NS_PER_S
from telepresence.link.compression import RtpDecompressor
from telepresence.link.flows import Flow, FlowKind, Level, check_flows
from telepresence.link.frame import (
    CLOSED,
    COUNT_MASK,
    COUNT_MODULUS,
    MAX_PACKET_OCTETS,
    NUMBER_MASK,
    TAG_FILL,
    TAG_PAD,
    TAG_RESUME,
    TYPE_CONTROL,
    TYPE_MASK,
    TYPE_RAW,
    FrameCodec,
    Pointers,
    length_octets,
)
from telepresence.link.profile import LinkProfile

#: A frame that is so little behind is late or repeated; one further behind is of a new life.
_LATE_FRAMES = 32


class HapticReceived(NamedTuple):
    """One sample out of an insert zone."""

    sample: bytes
    now_ns: int


class PacketReceived(NamedTuple):
    """One packet, bit for bit the UDP payload that went in at the other end of `flow`."""

    flow: Flow
    data: bytes
    now_ns: int


LinkEvent = HapticReceived | PacketReceived


class _Partial:
    """A packet of which the end is missing."""

    __slots__ = ("body", "count", "tag")

    def __init__(self, tag: int, count: int, body: bytes) -> None:
        self.tag = tag
        self.count = count
        self.body = bytearray(body)


class LinkReceiver:
    """Frames in by `handle_frame`, samples and packets out by `next_event`.

    Never raises on what a peer sends: it is counted by reason and dropped.
    """

    def __init__(self, profile: LinkProfile, flows: Sequence[Flow]) -> None:
        self.profile = profile
        self.flows = check_flows(flows)
        self._codec = FrameCodec(profile)
        self._pointers = Pointers(profile)
        self._zone_octets = profile.packet_zone_octets
        self._length_octets = length_octets(profile)
        self._decompressors = [
            RtpDecompressor(flow, profile.slot_ns) if flow.kind is FlowKind.RTP else None
            for flow in self.flows
        ]
        self._events: deque[LinkEvent] = deque()
        self._partials: list[_Partial | None] = [None] * len(Level)
        self._on_air: int | None = None
        #: The last frame's count, with the wraps of its 24 bits added up.
        self._count: int | None = None
        self._last_ns = 0
        self._last_late: int | None = None
        self.frames_received = 0
        self.frames_lost = 0
        self.restarts = 0
        #: How often the peer was met: its first frame, and each new life of it.
        self.meetings = 0
        self.haptic_received = 0
        self.frames_dropped: dict[str, int] = {}
        self.packets_dropped: dict[str, int] = {}
        self.packets_received = [0] * len(self.flows)

    def handle_frame(self, frame: bytes, now_ns: int) -> None:
        """What came from the radio, at `now_ns`. Drain `next_event` afterwards."""
        parsed = self._codec.parse(frame)
        if isinstance(parsed, str):
            self.frames_dropped[parsed] = self.frames_dropped.get(parsed, 0) + 1
            return
        count24, sample, pointer, zone = parsed
        last = self._count
        if last is not None and count24 == (last + 1) & COUNT_MASK:
            self._count = last + 1
            self._last_late = None
            self._last_ns = now_ns
        elif not self._follow(count24, now_ns):
            return
        self.frames_received += 1
        if sample is not None:
            self.haptic_received += 1
            self._events.append(HapticReceived(sample, now_ns))
        pointers = self._pointers
        on_air = self._on_air
        if pointer == pointers.no_start:
            if on_air is not None:
                self._extend(on_air, zone)
            return
        if pointer == pointers.idle:
            if on_air is not None:
                self._finish(on_air, now_ns)
            return
        if pointer == pointers.preempt:
            self._on_air = None
            self._parse_tags(zone, 0, now_ns)
            return
        if pointer > self._zone_octets:
            self._malformed()
            return
        if on_air is not None:
            self._extend(on_air, zone[:pointer])
            self._finish(self._on_air, now_ns)
        self._parse_tags(zone, pointer, now_ns)

    def next_event(self) -> LinkEvent | None:
        """What has been received, in order. Call until None."""
        return self._events.popleft() if self._events else None

    def _follow(self, count24: int, now_ns: int) -> bool:
        """Take the count of a frame that is not just the next; whether it is to be read."""
        last = self._count
        if last is None:
            self.meetings = 1
            self._count = count24
        else:
            ahead = count24 - last & COUNT_MASK
            behind = COUNT_MODULUS - ahead
            if count24 and (ahead == 0 or behind < _LATE_FRAMES):
                # Two in a row are no straggler: the peer began anew just below.
                follows = self._last_late is not None and count24 == self._last_late + 1
                self._last_late = count24
                if not (ahead and follows):
                    self.frames_dropped["late"] = self.frames_dropped.get("late", 0) + 1
                    return False
                self._restart(count24)
            elif self._is_restart(count24, ahead, now_ns):
                self._restart(count24)
            else:
                self.frames_lost += ahead - 1
                self._drop_partials()
                self._count = last + ahead
        self._last_late = None
        self._last_ns = now_ns
        return True

    def _is_restart(self, count24: int, ahead: int, now_ns: int) -> bool:
        """Whether a jump is rather a new life of the peer than a loss: each begins at 0, and no
        more frames can be lost than the time since the last one had slots for."""
        elapsed_ns = now_ns - self._last_ns
        lost_ns = ahead * self.profile.slot_ns
        return count24 == 0 or lost_ns > 2 * elapsed_ns + NS_PER_S

    def _restart(self, count24: int) -> None:
        self.restarts += 1
        self.meetings += 1
        self._drop_partials()
        for decompressor in self._decompressors:
            if decompressor is not None:
                decompressor.forget()
        self._count = count24

    def _drop_partials(self) -> None:
        for level, partial in enumerate(self._partials):
            if partial is not None:
                self._partials[level] = None
                self._drop_packet("incomplete")
        self._on_air = None

    def _drop_packet(self, reason: str) -> None:
        self.packets_dropped[reason] = self.packets_dropped.get(reason, 0) + 1

    def _malformed(self) -> None:
        """The peer does not keep to the tags: nothing that is under way can be trusted."""
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
        """The packet of `level` has ended."""
        self._on_air = None
        if level is None:
            return
        partial = self._partials[level]
        self._partials[level] = None
        if partial is not None:
            self._deliver(partial.tag, partial.count, bytes(partial.body), now_ns)

    def _parse_tags(self, zone: bytes, position: int, now_ns: int) -> None:
        size = self._zone_octets
        self._on_air = None
        assert self._count is not None
        while position < size:
            tag = zone[position]
            position += 1
            if tag == TAG_PAD:
                continue
            if tag == TAG_FILL:
                return
            number = tag & NUMBER_MASK
            control = tag & TYPE_MASK == TYPE_CONTROL
            if control:
                level = number - TAG_RESUME
                known = 0 <= level < len(Level)
            else:
                known = number < len(self.flows)
                level = self.flows[number].level if known else 0
            if not known:
                self._malformed()
                return
            if tag & CLOSED:
                start = position + self._length_octets
                end = start + int.from_bytes(zone[position:start], "big")
                if start > size or end > size:
                    self._malformed()
                    return
                position = end
                if not control:
                    self._deliver(tag & ~CLOSED, self._count, zone[start:end], now_ns)
                elif self._partials[level] is not None:
                    self._extend(level, zone[start:end])
                    self._finish(level, now_ns)
                continue
            if control:
                if self._partials[level] is not None:
                    self._on_air = level
                    self._extend(level, zone[position:])
                return
            if self._partials[level] is not None:
                self._drop_packet("incomplete")
            self._partials[level] = _Partial(tag, self._count, zone[position:])
            self._on_air = level
            return

    def _deliver(self, tag: int, count: int, body: bytes, now_ns: int) -> None:
        number = tag & NUMBER_MASK
        flow, decompressor = self.flows[number], self._decompressors[number]
        packet: bytes | str
        if decompressor is not None:
            packet = decompressor.decompress(tag & TYPE_MASK, body, count)
        else:
            packet = body if tag & TYPE_MASK == TYPE_RAW else "malformed"
        if isinstance(packet, str):
            self._drop_packet(packet)
            return
        self.packets_received[number] += 1
        self._events.append(PacketReceived(flow, packet, now_ns))

    def report(self) -> dict[str, Any]:
        """Frames, samples and packets, received, lost and dropped by reason."""
        return {
            "frames": self.frames_received,
            "frames_lost": self.frames_lost,
            "frames_dropped": dict(self.frames_dropped),
            "restarts": self.restarts,
            "haptic": {"received": self.haptic_received},
            "packets": {
                flow.name: received
                for flow, received in zip(self.flows, self.packets_received, strict=True)
            },
            "packets_dropped": dict(self.packets_dropped),
        }

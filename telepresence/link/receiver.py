"""The receiving end: whole packets and samples from frames; losses never join two packets."""

from collections import deque
from collections.abc import Sequence
from typing import NamedTuple

from kontur_av.clock import NS_PER_MS, NS_PER_S
from telepresence.link.flows import (
    Flow,
    HapticReceived,
    LinkEvent,
    PacketReceived,
    SupervisionReceived,
    check_flows,
)
from telepresence.link.frame import COUNT_MASK, COUNT_MODULUS, FrameCodec, Pointers
from telepresence.link.link_metrics import ReceiverMetrics
from telepresence.link.profile import SUPERVISION_OCTETS, LinkProfile
from telepresence.link.reassembly import PacketReassembly
from telepresence.link.repair.packets import RepairedPackets

#: A frame at most this far behind is late or repeated; farther behind it is of another stream.
_LATE_FRAMES = 32
#: A frame of the stream comes at most this much before the time that the frames before it predict,
#: and after a silence this share of it more: the delay may have become shorter.
_EARLY_NS = 20 * NS_PER_MS
_EARLY_SHIFT = 7
#: It comes at most this much later, and after a silence this share of it more: either end may have
#: left out slots.
_BEHIND_NS = NS_PER_S
_BEHIND_SHIFT = 2
#: After this long without a frame the count alone says too little: the window above is too wide.
_LONGEST_SILENCE_NS = 60 * NS_PER_S
#: A stream without a frame for this long is over; then another can be the unknown sender.
_UNKNOWN_SENDER_SILENCE_NS = 50 * NS_PER_MS
#: The expected arrival leaks by this share of a slot, so that it follows a growing delay.
_LEAK_SHIFT = 7

_new_event = tuple.__new__


class UnknownFrame(NamedTuple):
    """A good frame of a stream that the receiver does not follow.

    message: its supervision message, or None.
    frames, lasts_ns: of the unknown sender's stream so far, without a break; 0 if it is of none.
    """

    message: bytes | None
    frames: int
    lasts_ns: int


def _add(counts: dict[str, int], reason: str, number: int) -> None:
    """Add to a count; a reason without any has no entry."""
    counts[reason] = counts.get(reason, 0) + number
    if not counts[reason]:
        del counts[reason]


class LinkReceiver:
    """Takes frames by `handle_frame`; returns samples, packets and messages by `next_event`.

    Invalid data is counted by reason and dropped.

    It follows one stream of frames. A frame belongs to it if its count is ahead of the last one and
    fits the time that has passed. All other frames are dropped; `unknown` shows the latest, and
    `follow_unknown_sender` changes to its stream.

    profile, flows: the direction and its flow table, as at the other end.
    cautious: the first frame begins no stream; only `follow_unknown_sender` does.
    repair: restores lost zones; None where the profile has no repair, or the peer does not know it.
    unknown: the last frame handled, if it is good but not of the stream; else None.
    """

    def __init__(self, profile: LinkProfile, flows: Sequence[Flow]) -> None:
        self.profile = profile
        self.flows = check_flows(flows)
        self.cautious = False
        self.unknown: UnknownFrame | None = None
        self._parse = FrameCodec(profile).parse
        self._pointers = Pointers(profile)
        #: The events of `next_event`, oldest first.
        self.events: deque[LinkEvent] = deque()
        #: What comes in the frames' packet zones.
        self.packets = PacketReassembly(profile, self.flows, self.events)
        self.repair: RepairedPackets | None = None
        self.set_repair(True)
        #: The last frame's count, without the wraps of its 24 bits.
        self._count = 0
        #: The next count of the stream, -1 without a stream; when its frame is expected, by the
        #: earliest arrivals; when the last one came.
        self._next24 = -1
        self._begun = False
        self._due_ns = 0
        self._last_ns = 0
        self._slot_ns = profile.slot_ns
        self._step_ns = profile.slot_ns + (profile.slot_ns >> _LEAK_SHIFT)
        #: Handles an unknown sender's stream, so that its contexts are known if it is followed.
        self._other: LinkReceiver | None = None
        #: The one to follow if asked to: it has handled the unknown sender's last frame.
        self._candidate: LinkReceiver | None = None
        #: It handles an unknown sender's stream, and no unknown senders beside that.
        self._strange = False
        #: Of an unknown sender's stream: how its frames were counted, until it is followed.
        self._dropped_as: dict[str, int] = {}
        self._begun_ns = 0
        self.frames_received = 0
        self.frames_lost = 0
        self.restarts = 0
        self.haptic_received = 0
        self.haptic_unapproved = 0
        self.frames_dropped: dict[str, int] = {}

    @property
    def deliver(self) -> bool:
        """While False, samples and packets are dropped and counted as `unapproved`."""
        return self.packets.deliver

    @deliver.setter
    def deliver(self, deliver: bool) -> None:
        self.packets.deliver = deliver

    def set_repair(self, on: bool) -> None:
        """Whether lost zones are restored, where the profile has repair."""
        self._give_up_repair()
        self.repair = None
        self.packets.hand_on = self.packets.take
        if on and self.profile.repair != "off":
            self.repair = RepairedPackets(self.profile, self.packets)

    def handle_frame(self, frame: bytes, now_ns: int) -> bool:
        """Take a frame from the radio; return whether it is a good frame of a live peer.

        Drain `next_event` afterwards.
        """
        parsed = self._parse(frame)
        if isinstance(parsed, str):
            _add(self.frames_dropped, parsed, 1)
            return False
        count24, sample, pointer, zone = parsed
        self.unknown = None
        due_ns = self._due_ns
        if count24 == self._next24:
            self._count += 1
        elif (skipped := self._find_skipped(count24, now_ns)) is None:
            if not self._strange:
                self._handle_unknown_sender(frame, count24, now_ns)
            return False
        else:
            self.frames_lost += skipped
            if self.repair is None:
                self.packets.drop_incomplete()
            elif skipped:
                self.repair.handle_lost(self._count + 1, skipped, now_ns)
            self._count += skipped + 1
            due_ns = self._due_ns + skipped * self._slot_ns
        self._due_ns = (now_ns if now_ns < due_ns else due_ns) + self._step_ns
        self._next24 = count24 + 1 & COUNT_MASK
        self._last_ns = now_ns
        self.frames_received += 1
        if sample is not None:
            if self.packets.deliver:
                self.haptic_received += 1
                # This skips the NamedTuple's own `__new__`, once a millisecond.
                self.events.append(_new_event(HapticReceived, (sample, now_ns)))
            else:
                self.haptic_unapproved += 1
        (self.repair or self.packets).handle_zone(pointer, zone, self._count, now_ns)
        return True

    def handle_signal_lost(self, now_ns: int) -> None:
        """The signal is lost: drop incomplete packets, which would not be completed in time."""
        self._give_up_repair()
        self.packets.drop_incomplete()

    def forget_contexts(self) -> None:
        """Forget all header contexts: the peer began a new start."""
        self._give_up_repair()
        self.packets.forget_contexts()

    def _give_up_repair(self) -> None:
        if self.repair is not None:
            self.repair.give_up(self._last_ns)

    def next_event(self) -> LinkEvent | None:
        """The next event in the order of reception, or None. Call until None."""
        return self.events.popleft() if self.events else None

    def follow_unknown_sender(self, *, new_boot_id: bool) -> bool:
        """Follow the stream of `unknown`, and take what its frame carries; return whether it can.

        new_boot_id: another start of the peer sends it, with its own contexts. A stream of the same
        life that is behind the one before would bring frames again, so it is a late copy.
        """
        other = self._candidate
        if other is None:
            return False
        ahead = other._count - self._count & COUNT_MASK
        behind = ahead == 0 or ahead >= COUNT_MODULUS >> 1
        if behind and not new_boot_id and other._last_ns - self._last_ns <= _LONGEST_SILENCE_NS:
            return False
        self._other = self._candidate = self.unknown = None
        for reason, frames in other._dropped_as.items():
            _add(self.frames_dropped, reason, -frames)
        if self._next24 < 0:
            for event in other.events:
                self._count_unapproved(event, -1)
        other._give_up_repair()
        self.handle_signal_lost(self._last_ns)
        if new_boot_id:
            self.restarts += self._begun
            self._count = other._count
            self.frames_lost += other.frames_lost
        else:
            self.frames_lost += 0 if behind else ahead - other.frames_received
            # After hours the count may have gone through half its range.
            self._count += ahead or COUNT_MODULUS
        self._begun = True
        self.packets.go_on_from(other.packets, contexts=new_boot_id)
        self._next24, self._due_ns = other._next24, other._due_ns
        self._last_ns = other._last_ns
        # The peer's first frames were good ones, though what they carried was dropped.
        self.frames_received += other.frames_received
        for event in other.events:
            if isinstance(event, SupervisionReceived):
                self.packets.supervision_received += 1
            elif not self.deliver:
                self._count_unapproved(event, 1)
                continue
            elif isinstance(event, HapticReceived):
                self.haptic_received += 1
            else:
                self.packets.received[self.flows.index(event.flow)] += 1
            self.events.append(event)
        return True

    def leave(self) -> None:
        """Follow no stream until `follow_unknown_sender`."""
        self.handle_signal_lost(self._last_ns)
        self._next24 = -1

    def _find_skipped(self, count24: int, now_ns: int) -> int | None:
        """Return how many frames are missing before this one; None: it is not of the stream."""
        if self._next24 < 0:
            if self.cautious:
                return None
            self._begun, self._begun_ns = True, now_ns
            self._count, self._next24 = count24 - 1, count24
            # The first frame sets the time of all others.
            self._due_ns = now_ns
            return 0
        skipped = count24 - self._next24 & COUNT_MASK
        silence_ns = now_ns - self._last_ns
        early_ns = self._due_ns + skipped * self._slot_ns - now_ns
        behind_ns = silence_ns - (skipped + 1) * self._slot_ns
        fits = (
            early_ns <= _EARLY_NS + (silence_ns >> _EARLY_SHIFT)
            and behind_ns <= _BEHIND_NS + (silence_ns >> _BEHIND_SHIFT)
            and silence_ns <= _LONGEST_SILENCE_NS
        )
        return skipped if fits else None

    def _handle_unknown_sender(self, frame: bytes, count24: int, now_ns: int) -> None:
        """Drop a frame that is not of the stream, and note it if it may be of another one."""
        late = 0 < self._next24 - count24 & COUNT_MASK <= _LATE_FRAMES
        reason = "late" if late and self._next24 >= 0 else "stray"
        other = self._other
        if other is None or now_ns - other._last_ns >= _UNKNOWN_SENDER_SILENCE_NS:
            other = self._other = self._begin_other()
        other.events.clear()
        message = self._message(frame)
        frames = lasts_ns = 0
        taken = other.handle_frame(frame, now_ns)
        if taken:
            frames, lasts_ns = other.frames_received, now_ns - other._begun_ns
        elif message is not None:
            # It is of yet another stream, which its message may prove.
            other = self._begin_other()
            taken = other.handle_frame(frame, now_ns)
        _add(self.frames_dropped, reason, 1)
        self._candidate = other if taken else None
        if taken:
            _add(other._dropped_as, reason, 1)
            if self._next24 < 0:
                for event in other.events:
                    self._count_unapproved(event, 1)
        self.unknown = UnknownFrame(message, frames, lasts_ns)

    def _begin_other(self) -> "LinkReceiver":
        other = LinkReceiver(self.profile, self.flows)
        other._strange = True
        return other

    def _message(self, frame: bytes) -> bytes | None:
        parsed = self._parse(frame)
        if isinstance(parsed, str) or parsed[2] != self._pointers.supervision:
            return None
        return parsed[3][:SUPERVISION_OCTETS]

    def _count_unapproved(self, event: LinkEvent, events: int) -> None:
        if isinstance(event, HapticReceived):
            self.haptic_unapproved += events
        elif isinstance(event, PacketReceived):
            _add(self.packets.dropped, "unapproved", events)

    def report(self) -> ReceiverMetrics:
        """Return frames, samples and packets: received, lost, and dropped by reason."""
        packets = self.packets
        return ReceiverMetrics(
            frames_received=self.frames_received,
            frames_lost=self.frames_lost,
            frames_dropped=dict(self.frames_dropped),
            restarts=self.restarts,
            haptic_received=self.haptic_received,
            haptic_unapproved=self.haptic_unapproved,
            supervision_received=packets.supervision_received,
            packets={
                flow.name: received
                for flow, received in zip(self.flows, packets.received, strict=True)
            },
            packets_dropped=dict(packets.dropped),
            repaired=None if self.repair is None else self.repair.report(),
        )

"""The jitter buffer of a voice: when to play each Opus packet, and what to conceal."""

from collections import deque
from dataclasses import dataclass
from typing import NamedTuple

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.errors import ProtocolError
from kontur_av.media import AUDIO_CLOCK_HZ, BLOCK_SAMPLES
from kontur_av.rtp.arrivals import Transits
from kontur_av.rtp.payload_opus import holds_copy, is_pause, opus_samples
from kontur_av.rtp.receiver import RtpReceived
from kontur_av.rtp.wire import TimestampUnwrapper

#: A larger difference of two transits in a row is a new time line, not jitter.
_RESYNC_NS = 2 * NS_PER_S
#: Stretch or shorten a block by at most one part in this many: 25 ms a second, half a semitone.
_STRETCH = 40
#: The same for a block without speech: 10 ms each.
_PAUSE_STRETCH = 2
#: The first block waits this long, so that the other packets of its burst tell how late it is.
_SETTLE_NS = 10 * NS_PER_MS
#: The delay grows by stretching up to this much, and by inserted concealment beyond.
_STRETCHED_NS = 5 * NS_PER_MS
#: The delay is lowered only if it is too large by more than this.
_SLACK_NS = 3 * NS_PER_MS
#: Timestamps that waver about whole blocks by at most one part in this many mean those blocks.
_WAVER = 4
#: libopus conceals in steps of 2.5 ms.
_STEP_SAMPLES = AUDIO_CLOCK_HZ // 400


@dataclass(frozen=True, slots=True)
class PlayoutBlock:
    """One block of sound to play now. A `VoicePlayer` decodes it.

    payload: an Opus packet; None: conceal `samples` samples.
    timestamp: its 32-bit RTP timestamp.
    samples: its length at 48 kHz as sent.
    play_ns: when its first sample is due.
    played_samples: its length as played, stretched or shortened.
    recovered: `payload` is the packet after the missing one, and carries a copy of it.
    inserted: nothing was sent for it; it fills the time by which the delay grows.
    """

    payload: bytes | None
    timestamp: int
    samples: int
    play_ns: int
    played_samples: int
    recovered: bool = False
    inserted: bool = False


@dataclass(slots=True)
class PlayoutCounts:
    """Counts of blocks.

    played: with their own packet. recovered: from a copy in the next packet. concealed: without
    either. inserted: added while the delay grew. stretched, shortened: played longer, shorter.
    late: came after their time. dropped: pushed out of a full buffer, or left out after a silence
    or a stall so that later blocks are not late. garbage: packets that were not Opus. resyncs: new
    time lines.
    """

    played: int = 0
    recovered: int = 0
    concealed: int = 0
    inserted: int = 0
    stretched: int = 0
    shortened: int = 0
    late: int = 0
    dropped: int = 0
    garbage: int = 0
    resyncs: int = 0


class _Block(NamedTuple):
    payload: bytes
    samples: int
    timestamp: int


class _Newest(NamedTuple):
    """The packet of the highest sequence number."""

    sequence: int
    media: int
    samples: int


class PlayoutBuffer:
    """A jitter buffer that counts in time, not in packets. Its output has no gap.

    Pass packets to `handle_packet`. At `poll_timeout` call `handle_timeout`, then drain
    `next_event`.

    The transit of a packet is its arrival minus its media time. A block is played at its media time
    plus an offset. The offset wanted is the transit that all but `late_allowed` packets of the last
    `window_ns` did not exceed, plus `margin_ns`. It lies from `min_delay_ns` to `max_delay_ns`
    above the smallest transit. So a single stall or the burst of a start does not raise the delay:
    it is over when it is noticed. Its late blocks are lost.

    The offset grows at once, by concealment before the next block. Where a late block has just been
    concealed, that concealment counts, and the block is played after it. Up to 5 ms are gained by
    stretching. The offset shrinks by shortening each block by at most 1/40, or by half in pauses.

    Packets in a row are whole blocks, also where their timestamps waver, or leap although no time
    has passed.

    A missing block is recovered from a copy in its successor, else concealed. After
    `max_concealed` concealments in a row the buffer is silent until a packet comes.

    Queue: at most `max_blocks` blocks; the oldest is dropped, and so is a packet after its time.

    min_delay_ns, max_delay_ns: limits of the delay above the smallest transit.
    """

    def __init__(
        self,
        *,
        min_delay_ns: int = 10 * NS_PER_MS,
        max_delay_ns: int = 200 * NS_PER_MS,
        margin_ns: int = 5 * NS_PER_MS,
        window_ns: int = 5 * NS_PER_S,
        late_allowed: int = 5,
        max_concealed: int = 5,
        max_blocks: int = 50,
    ) -> None:
        self.counts = PlayoutCounts()
        self._min_delay_ns = min_delay_ns
        self._max_delay_ns = max_delay_ns
        self._margin_ns = margin_ns
        self._window_ns = window_ns
        self._late_allowed = late_allowed
        self._max_concealed = max_concealed
        self._max_blocks = max_blocks
        self._events: deque[PlayoutBlock] = deque()
        #: The end of the sound returned so far; no block may begin before.
        self._free_ns: int | None = None
        self._reset()

    def _reset(self) -> None:
        # Media times count samples since an arbitrary first packet, without wrap-around.
        self._blocks: dict[int, _Block] = {}
        self._unwrapper = TimestampUnwrapper()
        self._origin: int | None = None
        self._newest: _Newest | None = None
        #: By how much the newest timestamp is ahead of whole blocks.
        self._astray = 0
        self._transits = Transits(window_ns=self._window_ns, late_allowed=self._late_allowed)
        self._offset_ns: int | None = None
        self._floor_ns: int | None = None
        self._lowering = False
        self._next: int | None = None
        self._played_up_to: int | None = None
        #: The last block returned is the concealment of this media time, which may still come.
        self._just_concealed: int | None = None
        self._samples = BLOCK_SAMPLES
        self._concealed_in_row = 0
        #: The next block is the first one, or the first after a silence.
        self._beginning = False

    @property
    def delay_ns(self) -> int:
        """How long a packet of the smallest transit waits until it is played, in ns."""
        if self._offset_ns is None or not self._transits:
            return 0
        return self._offset_ns - self._transits.quickest_ns

    def __len__(self) -> int:
        return len(self._blocks)

    def hold(self, timestamp: int, until_ns: int | None) -> None:
        """Delay playout so that the block of `timestamp` is played no earlier than `until_ns`.

        The delay grows by stretching alone, up to the largest delay. None ends the hold.
        """
        if until_ns is None or self._origin is None:
            self._floor_ns = None
        else:
            self._floor_ns = until_ns - _ns(self._unwrapper.unwrap(timestamp) - self._astray)

    def handle_packet(self, packet: RtpReceived) -> None:
        """Handle a packet that arrived at its `received_ns`. Garbage is counted."""
        try:
            samples = opus_samples(packet.payload)
        except ProtocolError:
            self.counts.garbage += 1
            return
        now_ns = packet.received_ns
        # Blocks due before this arrival are played without it.
        self.handle_timeout(now_ns)
        if packet.restart:
            self._resync()
        media = self._unwrapper.unwrap(packet.timestamp) - self._astray
        last_ns = self._transits.last_ns
        if last_ns is not None and abs(now_ns - _ns(media) - last_ns) > _RESYNC_NS:
            self._resync()
            media = self._unwrapper.unwrap(packet.timestamp)
        media = self._in_whole_blocks(packet, media, samples)
        self._transits.handle_arrival(now_ns, now_ns - _ns(media))
        ceiling_ns = self._transits.quickest_ns + self._max_delay_ns
        if self._offset_ns is not None and self._offset_ns > ceiling_ns:
            # After a stall packets come in a burst: drop all that are too old at once.
            self._skip_overdue(ceiling_ns, now_ns)
        if self._origin is None:
            self._origin = (packet.timestamp - media) & 0xFFFF_FFFF
        if self._played_up_to is not None and media < self._played_up_to:
            if media != self._just_concealed or self._lacking_ns() <= _STRETCHED_NS:
                self.counts.late += 1
                return
            self._rewind(media)
        self._blocks[media] = _Block(packet.payload, samples, packet.timestamp)
        if self._next is None:
            self._begin(min(self._blocks), now_ns)
        elif media < self._next:
            self._next = media
            if self._free_ns is not None and self._offset_ns is not None:
                # It may be due before the sound returned so far ends.
                self._offset_ns = max(self._offset_ns, self._free_ns - _ns(media))
        if len(self._blocks) > self._max_blocks:
            oldest = min(self._blocks)
            self._pass(oldest, self._blocks.pop(oldest).samples)
            self.counts.dropped += 1

    def _in_whole_blocks(self, packet: RtpReceived, media: int, samples: int) -> int:
        newest, ahead = self._newest, 1
        if newest is not None:
            ahead = packet.extended_sequence - newest.sequence
            whole = newest.media + ahead * (newest.samples if ahead > 0 else samples)
            astray = media - whole
            if astray and (
                abs(astray) <= samples // _WAVER
                or (ahead == 1 and self._leaps(media, newest.media, packet.received_ns))
            ):
                self._astray += astray if ahead > 0 else 0
                media = whole
        if ahead > 0:
            self._newest = _Newest(packet.extended_sequence, media, samples)
        return media

    def _leaps(self, media: int, before: int, now_ns: int) -> bool:
        """Return whether a packet is older than the one before, or too quick to be dated right."""
        too_quick_ns = self._transits.quickest_ns - self._max_delay_ns
        return media < before or now_ns - _ns(media) < too_quick_ns

    def _resync(self) -> None:
        if self._origin is None:
            return
        self.counts.resyncs += 1
        self.counts.dropped += len(self._blocks)
        self._reset()

    def _skip_overdue(self, offset_ns: int, now_ns: int) -> None:
        for media in sorted(self._blocks):
            samples = self._blocks[media].samples
            if _ns(media + samples) + offset_ns > now_ns:
                break
            del self._blocks[media]
            self.counts.dropped += 1
            self._next = self._played_up_to = media + samples
        self._offset_ns = offset_ns
        if self._beginning and not self._blocks:
            # All that was to begin is gone: begin with the next packet.
            self._beginning, self._next = False, None
        if self._next is not None and self._free_ns is not None:
            self._offset_ns = max(offset_ns, self._free_ns - _ns(self._next))

    def _target_ns(self) -> int:
        """The offset that the jitter of the window needs."""
        quickest_ns = self._transits.quickest_ns
        wanted_ns = self._transits.bound_ns + self._margin_ns
        return min(
            max(wanted_ns, quickest_ns + self._min_delay_ns), quickest_ns + self._max_delay_ns
        )

    def _wanted_ns(self) -> int:
        """The offset that jitter and `hold` need."""
        target_ns = self._target_ns()
        if self._floor_ns is None:
            return target_ns
        return max(target_ns, min(self._floor_ns, self._transits.quickest_ns + self._max_delay_ns))

    def _lacking_ns(self) -> int:
        """By how much the offset is too small for the jitter."""
        assert self._offset_ns is not None
        return self._target_ns() - self._offset_ns

    def _begin(self, media: int, now_ns: int) -> None:
        """Play `media` next, first or after a silence: the offset is free."""
        earliest_ns = now_ns + _SETTLE_NS
        if self._free_ns is not None:
            earliest_ns = max(earliest_ns, self._free_ns)
        self._offset_ns = max(self._wanted_ns(), earliest_ns - _ns(media))
        self._next = media
        self._beginning = True

    def _settle(self, now_ns: int) -> None:
        """Drop blocks that came so late that they would delay all later ones."""
        self._beginning = False
        wanted_ns = self._wanted_ns()
        waiting = sorted(self._blocks)
        for media in waiting[:-1]:
            if _ns(media) + wanted_ns >= now_ns:
                break
            del self._blocks[media]
            self.counts.dropped += 1
        self._next = media = min(self._blocks)
        self._offset_ns = max(wanted_ns, now_ns - _ns(media))

    def _rewind(self, media: int) -> None:
        """Count the concealment of `media` as the growth of the delay, and play `media` now."""
        assert self._played_up_to is not None and self._offset_ns is not None
        self._offset_ns += _ns(self._played_up_to - media)
        self._next = self._played_up_to = media
        self._just_concealed = None
        self._concealed_in_row = 0
        self.counts.concealed -= 1
        self.counts.inserted += 1

    def poll_timeout(self) -> int | None:
        """Return when the next block is due; None during a silence."""
        if self._next is None or self._offset_ns is None:
            return None
        return _ns(self._next) + self._offset_ns

    def handle_timeout(self, now_ns: int) -> None:
        """Make an event of every block that is due by `now_ns`."""
        while (due_ns := self.poll_timeout()) is not None and due_ns <= now_ns:
            self._play(due_ns)

    def _play(self, due_ns: int) -> None:
        if self._beginning:
            self._settle(due_ns)
            return
        assert self._next is not None
        media = self._next
        self._just_concealed = None
        if self._played_up_to is not None and self._lacking_ns() > _STRETCHED_NS:
            self._insert(media, due_ns)
            return
        block = self._blocks.pop(media, None)
        if block is not None:
            self._concealed_in_row = 0
            self._samples = block.samples
            self.counts.played += 1
            self._emit(block.payload, media, block.samples, due_ns, timestamp=block.timestamp)
            return
        following = self._blocks.get(media + self._samples)
        if following is not None and holds_copy(following.payload):
            self._concealed_in_row = 0
            self.counts.recovered += 1
            self._emit(following.payload, media, self._samples, due_ns, recovered=True)
            return
        if self._concealed_in_row >= self._max_concealed:
            # Silence: go on with the earliest packet, or wait for one.
            self._concealed_in_row = 0
            self._next = None
            if self._blocks:
                self._begin(min(self._blocks), due_ns)
            return
        self._concealed_in_row += 1
        samples = self._samples
        if self._blocks:
            # Blocks of another length may follow: conceal only up to the next one.
            samples = min(samples, min(self._blocks) - media)
        self.counts.concealed += 1
        self._emit(None, media, samples, due_ns)
        self._just_concealed = media

    def _insert(self, media: int, due_ns: int) -> None:
        """Insert concealment before `media` until the offset suffices, one block at a time."""
        assert self._offset_ns is not None
        steps = -(-self._lacking_ns() * AUDIO_CLOCK_HZ // (NS_PER_S * _STEP_SAMPLES))
        samples = min(steps * _STEP_SAMPLES, BLOCK_SAMPLES)
        self.counts.inserted += 1
        timestamp = self._timestamp(media)
        self._events.append(PlayoutBlock(None, timestamp, samples, due_ns, samples, inserted=True))
        self._offset_ns += _ns(samples)
        self._free_ns = due_ns + _ns(samples)

    def _emit(
        self,
        payload: bytes | None,
        media: int,
        samples: int,
        due_ns: int,
        *,
        timestamp: int | None = None,
        recovered: bool = False,
    ) -> None:
        assert self._offset_ns is not None
        if timestamp is None:
            timestamp = self._timestamp(media)
        pause = payload is not None and not recovered and is_pause(payload)
        played = samples + self._stretch(samples, _PAUSE_STRETCH if pause else _STRETCH)
        self._events.append(
            PlayoutBlock(payload, timestamp, samples, due_ns, played, recovered=recovered)
        )
        self._offset_ns += _ns(played - samples)
        self._free_ns = due_ns + _ns(played)
        self._pass(media, samples)

    def _timestamp(self, media: int) -> int:
        assert self._origin is not None
        return (self._origin + media + self._astray) & 0xFFFF_FFFF

    def _stretch(self, samples: int, parts: int) -> int:
        """Return the samples to add to a block, or to take away if negative.

        At most one part in `parts` of the block.
        """
        assert self._offset_ns is not None
        wanted_ns = self._wanted_ns()
        lacking = (wanted_ns - self._offset_ns) * AUDIO_CLOCK_HZ // NS_PER_S
        if lacking >= 0:
            self._lowering = False
        elif wanted_ns + _SLACK_NS < self._offset_ns:
            self._lowering = True
        if lacking > 0:
            self.counts.stretched += 1
            return min(lacking, samples // parts)
        if self._lowering:
            self.counts.shortened += 1
            return max(lacking, -(samples // parts))
        return 0

    def _pass(self, media: int, samples: int) -> None:
        self._next = self._played_up_to = media + samples
        for old in [old for old in self._blocks if old < self._next]:
            del self._blocks[old]
            self.counts.dropped += 1

    def next_event(self) -> PlayoutBlock | None:
        """Return the next block that is due, or None."""
        return self._events.popleft() if self._events else None


def _ns(samples: int) -> int:
    return samples * NS_PER_S // AUDIO_CLOCK_HZ

"""The jitter buffer of a voice: when each Opus packet is to be played, and what to conceal."""

from collections import deque
from dataclasses import dataclass

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.errors import ProtocolError
from kontur_av.media import AUDIO_CLOCK_HZ, BLOCK_SAMPLES
from kontur_av.rtp.payload_opus import opus_samples
from kontur_av.rtp.receiver import RtpReceived
from kontur_av.rtp.wire import TimestampUnwrapper

#: A transit that differs by more than this from the last one is a new time line, not jitter.
_RESYNC_NS = 2 * NS_PER_S


@dataclass(frozen=True, slots=True)
class PlayoutBlock:
    """One block of sound whose time has come.

    payload: an Opus packet, or None: the decoder conceals `samples` samples.
    timestamp: its 32-bit RTP timestamp.  play_ns: when its first sample is due.
    """

    payload: bytes | None
    timestamp: int
    samples: int
    play_ns: int


@dataclass(slots=True)
class PlayoutCounts:
    """played: blocks given out with sound.  concealed: without.  late: came after their time.
    dropped: the oldest, pushed out of a full buffer.  garbage: no Opus.  resyncs: new time lines.
    """

    played: int = 0
    concealed: int = 0
    late: int = 0
    dropped: int = 0
    garbage: int = 0
    resyncs: int = 0


@dataclass(slots=True)
class _Block:
    payload: bytes
    samples: int
    received_ns: int


class PlayoutBuffer:
    """A jitter buffer counted in time, not in packets.

    Each packet's transit is its arrival minus its media time. A block is played at its media
    time plus an offset: the largest transit of the last `window_ns` plus `margin_ns`, and at
    least the smallest one plus `min_delay_ns`, at most plus `max_delay_ns`. More jitter raises
    the offset at once; less lowers it slowly, by at most 1/40 of the time played, so that no
    syllable is cut off.

    Feed `handle_packet`; when `poll_timeout` is due call `handle_timeout`, then drain
    `next_event`. A missing block gives a concealment at its time, at most `max_concealed` in a
    row; after that the buffer is silent until a packet comes. The oldest goes: a packet that
    comes after its time is dropped, and so is the oldest of more than `max_blocks`.
    """

    def __init__(
        self,
        *,
        min_delay_ns: int = 10 * NS_PER_MS,
        max_delay_ns: int = 200 * NS_PER_MS,
        margin_ns: int = 5 * NS_PER_MS,
        window_ns: int = 10 * NS_PER_S,
        max_concealed: int = 5,
        max_blocks: int = 50,
    ) -> None:
        self.counts = PlayoutCounts()
        self._min_delay_ns = min_delay_ns
        self._max_delay_ns = max_delay_ns
        self._margin_ns = margin_ns
        self._window_ns = window_ns
        self._max_concealed = max_concealed
        self._max_blocks = max_blocks
        self._events: deque[PlayoutBlock] = deque()
        self._reset()

    def _reset(self) -> None:
        # Media times count samples since an arbitrary first packet, without wrap-around.
        self._blocks: dict[int, _Block] = {}
        self._unwrapper = TimestampUnwrapper()
        self._origin: int | None = None
        # Candidates for the largest and the smallest transit of the window, as (when, transit):
        # only those that no later one outdoes are kept, so both ends are found at the front.
        self._largest: deque[tuple[int, int]] = deque()
        self._smallest: deque[tuple[int, int]] = deque()
        self._last_transit_ns = 0
        self._offset_ns: int | None = None
        self._next: int | None = None
        self._played_up_to: int | None = None
        self._samples = BLOCK_SAMPLES
        self._concealed_in_row = 0

    @property
    def delay_ns(self) -> int:
        """How long a packet of the quickest transit waits before it is played."""
        if self._offset_ns is None or not self._smallest:
            return 0
        return self._offset_ns - self._smallest[0][1]

    def oldest_age_ns(self, now_ns: int) -> int:
        """How long the packet that plays next has waited."""
        if not self._blocks:
            return 0
        return now_ns - self._blocks[min(self._blocks)].received_ns

    def __len__(self) -> int:
        return len(self._blocks)

    def handle_packet(self, packet: RtpReceived) -> None:
        """Take a packet; its `received_ns` is the instant of its arrival."""
        try:
            samples = opus_samples(packet.payload)
        except ProtocolError:
            self.counts.garbage += 1
            return
        now_ns = packet.received_ns
        # What was due before this arrival is decided without it.
        self.handle_timeout(now_ns)
        if packet.restart:
            self._resync()
        media = self._unwrapper.unwrap(packet.timestamp)
        transit_ns = now_ns - _ns(media)
        if self._largest and abs(transit_ns - self._last_transit_ns) > _RESYNC_NS:
            self._resync()
            media = self._unwrapper.unwrap(packet.timestamp)
            transit_ns = now_ns - _ns(media)
        self._observe(now_ns, transit_ns)
        if self._origin is None:
            self._origin = (packet.timestamp - media) & 0xFFFF_FFFF
        if self._played_up_to is not None and media < self._played_up_to:
            self.counts.late += 1
            return
        self._blocks[media] = _Block(packet.payload, samples, now_ns)
        if self._next is None:
            self._next = min(self._blocks)
        elif media < self._next:
            self._next = media
        if len(self._blocks) > self._max_blocks:
            oldest = min(self._blocks)
            self._pass(oldest, self._blocks.pop(oldest).samples)
            self.counts.dropped += 1

    def _resync(self) -> None:
        if self._origin is None:
            return
        self.counts.resyncs += 1
        self.counts.dropped += len(self._blocks)
        self._reset()

    def _observe(self, now_ns: int, transit_ns: int) -> None:
        self._last_transit_ns = transit_ns
        while self._largest and self._largest[-1][1] <= transit_ns:
            self._largest.pop()
        while self._smallest and self._smallest[-1][1] >= transit_ns:
            self._smallest.pop()
        self._largest.append((now_ns, transit_ns))
        self._smallest.append((now_ns, transit_ns))
        for window in (self._largest, self._smallest):
            while window[0][0] < now_ns - self._window_ns:
                window.popleft()
        target_ns = self._target_ns()
        if self._offset_ns is None or target_ns > self._offset_ns:
            self._offset_ns = target_ns
        ceiling_ns = self._smallest[0][1] + self._max_delay_ns
        if self._offset_ns > ceiling_ns:
            # After a stall the queue empties in a burst: what is too old goes, all at once.
            self._offset_ns = ceiling_ns
            self._skip_overdue(now_ns)

    def _skip_overdue(self, now_ns: int) -> None:
        assert self._offset_ns is not None
        for media in sorted(self._blocks):
            samples = self._blocks[media].samples
            if _ns(media + samples) + self._offset_ns > now_ns:
                return
            del self._blocks[media]
            self.counts.dropped += 1
            self._next = self._played_up_to = media + samples

    def _target_ns(self) -> int:
        quickest_ns = self._smallest[0][1]
        wanted_ns = max(self._largest[0][1] + self._margin_ns, quickest_ns + self._min_delay_ns)
        return min(wanted_ns, quickest_ns + self._max_delay_ns)

    def poll_timeout(self) -> int | None:
        """When the next block is due; None while nothing is to be played or concealed."""
        if self._next is None or self._offset_ns is None:
            return None
        return _ns(self._next) + self._offset_ns

    def handle_timeout(self, now_ns: int) -> None:
        """Give out every block whose time has come."""
        while (due_ns := self.poll_timeout()) is not None and due_ns <= now_ns:
            self._play(due_ns)

    def _play(self, due_ns: int) -> None:
        assert self._next is not None and self._origin is not None
        media = self._next
        timestamp = (self._origin + media) & 0xFFFF_FFFF
        block = self._blocks.pop(media, None)
        if block is not None:
            self._concealed_in_row = 0
            self._samples = block.samples
            self.counts.played += 1
            self._events.append(PlayoutBlock(block.payload, timestamp, block.samples, due_ns))
            self._pass(media, block.samples)
            return
        if self._concealed_in_row >= self._max_concealed:
            # Silence: go on with the earliest packet there is, or wait for one.
            self._concealed_in_row = 0
            self._next = min(self._blocks) if self._blocks else None
            return
        self._concealed_in_row += 1
        samples = self._samples
        if self._blocks:
            # Blocks of another length may follow: conceal no further than to the next one.
            samples = min(samples, min(self._blocks) - media)
        self.counts.concealed += 1
        self._events.append(PlayoutBlock(None, timestamp, samples, due_ns))
        self._pass(media, samples)

    def _pass(self, media: int, samples: int) -> None:
        self._next = self._played_up_to = media + samples
        for old in [old for old in self._blocks if old < self._next]:
            del self._blocks[old]
            self.counts.dropped += 1
        if self._offset_ns is not None:
            slower_ns = self._offset_ns - _ns(samples) // 40
            self._offset_ns = max(min(self._offset_ns, self._target_ns()), slower_ns)

    def next_event(self) -> PlayoutBlock | None:
        """The next block that is due, or None."""
        return self._events.popleft() if self._events else None


def _ns(samples: int) -> int:
    return samples * NS_PER_S // AUDIO_CLOCK_HZ

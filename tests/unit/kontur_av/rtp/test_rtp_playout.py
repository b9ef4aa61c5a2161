"""The jitter buffer: timing, order, and the handling of missing packets."""

import itertools
import random

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from rtp_packets import PromptSender, received

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.media import CaptureStamp
from kontur_av.rtp.payload_opus import holds_copy, is_pause
from kontur_av.rtp.playout import PlayoutBuffer
from kontur_av.rtp.receiver import RtpReceiver
from kontur_av.rtp.wire import pack_rtp

BLOCK_NS = 20 * NS_PER_MS


class Line:
    """A voice through a network: (arrival, packet number) pairs go in, blocks come out."""

    def __init__(self, *, pauses=(), **playout):
        self.pauses = pauses
        self.buffer = PlayoutBuffer(**playout)
        self.receiver = RtpReceiver(payload_type=97, clock_rate_hz=48_000, ordered=False)
        self.sender = PromptSender(
            payload_type=97,
            clock_rate_hz=48_000,
            ssrc=5,
            first_sequence=65_500,
            timestamp_offset=2**32 - 48_000,
            cname="voice",
        )
        self.blocks = []

    def run(self, arrivals, sequences=None, until_ns=None):
        """arrivals: ns for each packet number, or None if lost. Steps to the next due time."""
        events = []
        for number, arrival_ns in enumerate(arrivals):
            sequence = number if sequences is None else sequences[number]
            stamp = CaptureStamp(sequence * BLOCK_NS, sequence, "mic")
            # TOC of 20 ms SILK, the voice activity flag, then the number of the block.
            flags = b"\0" if number in self.pauses else b"\x80"
            payload = b"\x08" + flags + number.to_bytes(2, "big")
            (packet,) = self.sender.audio_packets(payload, stamp).packets
            if arrival_ns is not None:
                events.append((arrival_ns, packet))
        for arrival_ns, packet in sorted(events):
            self.advance(arrival_ns)
            self.receiver.handle_packet(packet, arrival_ns)
            self.pass_on()
        self.advance(until_ns or max(time for time, _ in events) + NS_PER_S)
        return self.blocks

    def advance(self, now_ns):
        while True:
            due = [self.receiver.poll_timeout(), self.buffer.poll_timeout()]
            due_ns = min((time for time in due if time is not None), default=None)
            if due_ns is None or due_ns > now_ns:
                return
            self.receiver.handle_timeout(due_ns)
            self.pass_on()
            self.buffer.handle_timeout(due_ns)
            self._drain()

    def pass_on(self):
        while (event := self.receiver.next_event()) is not None:
            self.buffer.handle_packet(event)
            self._drain()

    def _drain(self):
        while (block := self.buffer.next_event()) is not None:
            self.blocks.append(block)


def length_ns(samples):
    return samples * NS_PER_S // 48_000


def heard(blocks) -> list:
    return [b.payload and int.from_bytes(b.payload[2:], "big") for b in blocks]


def test_a_steady_voice_is_played_at_a_steady_pace_across_wrap_around():
    line = Line()
    blocks = line.run([n * BLOCK_NS for n in range(100)])
    assert heard(blocks)[:100] == list(range(100))
    times = [block.play_ns for block in blocks]
    assert {b - a for a, b in itertools.pairwise(times)} == {BLOCK_NS}
    # Without a report the first block waits for the second (probation), then for the least delay.
    assert line.buffer.delay_ns <= 30 * NS_PER_MS
    assert line.buffer.counts.late == 0


def test_jitter_raises_the_delay_until_nothing_is_late():
    rng = random.Random(1)
    arrivals = [n * BLOCK_NS + rng.randrange(40 * NS_PER_MS) for n in range(1500)]
    line = Line(window_ns=5 * NS_PER_S)
    blocks = line.run(arrivals)
    late_half = heard(blocks)[750:1450]
    assert late_half.count(None) == 0
    assert 35 * NS_PER_MS <= line.buffer.delay_ns <= 50 * NS_PER_MS


def test_the_delay_goes_down_again_and_no_block_is_skipped():
    arrivals = [n * BLOCK_NS + (60 * NS_PER_MS if n == 50 else 0) for n in range(1500)]
    line = Line(window_ns=5 * NS_PER_S)
    blocks = line.run(arrivals)
    assert [n for n in heard(blocks) if n is not None] == [n for n in range(1500) if n != 50]
    assert line.buffer.delay_ns <= 15 * NS_PER_MS
    times = [block.play_ns for block in blocks]
    steps = [b - a for a, b in itertools.pairwise(times)]
    assert min(steps) >= BLOCK_NS * 39 // 40 - 1


def jittery(rng, count, jitter_ms, since_ns=0):
    return [since_ns + n * BLOCK_NS + rng.randrange(jitter_ms * NS_PER_MS) for n in range(count)]


def test_rare_stalls_do_not_raise_the_delay():
    # In each stall three blocks arrive together, the first of them 45 ms late.
    stalled = {n + k: n * 20 + 45 for n in range(50, 1000, 250) for k in range(3)}
    arrivals = [stalled.get(n, n * 20) * NS_PER_MS for n in range(1000)]
    line = Line()
    blocks = line.run(arrivals, until_ns=arrivals[-1] + 5 * NS_PER_MS)
    assert {b.play_ns - n * BLOCK_NS for n, b in enumerate(blocks)} == {10 * NS_PER_MS}
    assert heard(blocks).count(None) == 2 * 4


def test_frequent_lateness_raises_the_delay():
    late = dict.fromkeys(range(50, 200, 20), 12)
    arrivals = [(n * 20 + late.get(n, 0)) * NS_PER_MS for n in range(260)]
    line = Line(late_allowed=2)
    blocks = line.run(arrivals, until_ns=arrivals[-1] + 5 * NS_PER_MS)
    # Two are concealed and dropped; the third is played after its own concealment.
    played = [n for n in heard(blocks) if n is not None]
    assert played[:240] == [n for n in range(242) if n not in (50, 70)]
    counts = line.buffer.counts
    assert (counts.late, counts.concealed, counts.inserted) == (2, 2, 1)
    # 12 ms and the margin of 5; additional delay has been removed by time compression.
    assert 17 * NS_PER_MS <= line.buffer.delay_ns <= 20 * NS_PER_MS


def test_a_missing_delay_after_a_stall_is_inserted_at_once():
    # Twice three blocks arrive together, the first of them 45 ms late.
    stalled = {n + k: n * 20 + 45 for n in (50, 90) for k in range(3)}
    arrivals = [stalled.get(n, n * 20) * NS_PER_MS for n in range(100)]
    line = Line(late_allowed=1)
    blocks = line.run(arrivals, until_ns=arrivals[-1] + NS_PER_MS)
    assert line.buffer.delay_ns >= 40 * NS_PER_MS
    assert line.buffer.counts.inserted >= 1
    assert max(assert_gapless(blocks)) < 1000


def test_a_longer_path_costs_only_some_blocks():
    arrivals = [n * BLOCK_NS + (60 * NS_PER_MS if n >= 100 else 0) for n in range(200)]
    line = Line()
    blocks = line.run(arrivals, until_ns=arrivals[-1] + NS_PER_MS)
    missing = [n for n in range(195) if n not in heard(blocks)]
    assert missing and missing[-1] <= 104
    assert max(assert_gapless(blocks)) < 1000


def test_a_queue_before_the_start_does_not_delay_later_blocks():
    # Everything up to 70 ms arrives at once; from the fourth block on nothing waits.
    arrivals = [max(n * 20, 70 + n // 3) * NS_PER_MS for n in range(100)]
    line = Line()
    blocks = line.run(arrivals, until_ns=arrivals[-1] + 5 * NS_PER_MS)
    numbers = [n for n in heard(blocks) if n is not None]
    assert numbers == list(range(numbers[0], 99)) and numbers[0] <= 4
    assert blocks[0].play_ns <= 100 * NS_PER_MS
    delays = [b.play_ns - n * BLOCK_NS for n, b in zip(numbers, blocks, strict=True)]
    assert max(delays) <= 22 * NS_PER_MS
    assert delays[30:] == [10 * NS_PER_MS] * (len(delays) - 30)


def test_a_burst_at_the_start_is_played_from_its_newest_blocks():
    # Fifteen blocks at once, 300 ms of sound: more than the largest delay.
    arrivals = [max(n * 20, 290) * NS_PER_MS + n for n in range(60)]
    line = Line()
    blocks = line.run(arrivals, until_ns=arrivals[-1] + 5 * NS_PER_MS)
    numbers = [n for n in heard(blocks) if n is not None]
    assert numbers == list(range(numbers[0], numbers[-1] + 1))
    assert 5 <= numbers[0] == line.buffer.counts.dropped <= 6
    # It is played 200 ms after the media time, the largest delay, and 0.5 ms less with each block.
    assert numbers[-1] >= 48
    assert max(assert_gapless(blocks)) < 1000


def test_packets_that_are_reordered_after_a_silence_are_played_in_order():
    sequences = [*range(20), *range(60, 80)]
    arrivals = [s * BLOCK_NS for s in sequences]
    arrivals[20] = arrivals[21] + NS_PER_MS
    line = Line()
    assert [n for n in heard(line.run(arrivals, sequences)) if n is not None] == list(range(40))
    assert line.buffer.counts.late == line.buffer.counts.dropped == 0


def test_a_voice_begins_after_a_burst_in_which_all_was_too_old():
    # After a silence two blocks come 300 ms late, the later one first.
    sequences = [*range(20), 60, 61, *range(80, 95)]
    arrivals = [s * BLOCK_NS for s in sequences]
    arrivals[20:22] = [arrivals[20] + late_ms * NS_PER_MS for late_ms in (305, 300)]
    line = Line(max_delay_ns=60 * NS_PER_MS)
    blocks = line.run(arrivals, sequences)
    assert [n for n in heard(blocks) if n is not None] == [*range(20), *range(22, 37)]
    assert (line.buffer.counts.dropped, line.buffer.counts.late) == (1, 1)
    list(assert_gapless(blocks))


def test_every_block_counts_once_as_what_it_was_played_as():
    rng = random.Random(11)
    arrivals = [None if n % 17 == 5 else at for n, at in enumerate(jittery(rng, 400, 90))]
    line = Line()
    blocks = line.run(arrivals)
    counts = line.buffer.counts
    gaps = [block for block in blocks if block.payload is None]
    assert counts.played == len(blocks) - len(gaps)
    assert counts.inserted + counts.concealed == len(gaps)
    longer = [b for b in blocks if b.played_samples > b.samples]
    shorter = [b for b in blocks if b.played_samples < b.samples]
    assert (counts.stretched, counts.shortened) == (len(longer), len(shorter))
    came = len([at for at in arrivals if at is not None])
    assert counts.played + counts.late + counts.dropped == came
    assert min(counts.inserted, counts.concealed, counts.late, len(longer), len(shorter)) > 0


def test_a_concealment_after_a_silence_counts_from_the_voice():
    """Two silences: after each, five concealments at most."""
    sequences = [*range(20), *range(60, 80), *range(120, 140)]
    line = Line(max_concealed=3)
    blocks = line.run([s * BLOCK_NS for s in sequences], sequences)
    heard_all = heard(blocks)
    assert heard_all[20:23] == [None] * 3 and heard_all[43:46] == [None] * 3
    assert line.buffer.counts.concealed == 9
    assert line.buffer.poll_timeout() is None


def test_a_pause_takes_the_delay_down_at_once():
    late = dict.fromkeys(range(60, 310), 60)
    arrivals = [(n * 20 + late.get(n, 0)) * NS_PER_MS for n in range(400)]
    line = Line(window_ns=NS_PER_S, pauses=range(365, 375))
    blocks = line.run(arrivals, until_ns=arrivals[-1] + NS_PER_MS)
    # Two hundred and fifty blocks are late; the following ones are not, and soon there is a pause.
    heard_at = zip(heard(blocks), blocks, strict=True)
    delays = {n: b.play_ns - n * BLOCK_NS for n, b in heard_at if n is not None}
    assert delays[364] >= 55 * NS_PER_MS
    assert delays[372] <= 15 * NS_PER_MS
    shortest = min(b.played_samples for b in blocks)
    assert 480 <= shortest < 936


def test_a_new_time_line_waits_for_the_end_of_the_old_one():
    rng = random.Random(5)
    arrivals = jittery(rng, 100, 60) + [n * BLOCK_NS + 50 * NS_PER_MS for n in range(100, 200)]
    sequences = [*range(100), *range(5100, 5200)]
    line = Line()
    blocks = line.run(arrivals, sequences)
    assert line.buffer.counts.resyncs == 1
    list(assert_gapless(blocks))


def test_the_delay_follows_the_jitter_down_within_seconds():
    rng = random.Random(3)
    rough = jittery(rng, 500, 60)
    calm = jittery(rng, 450, 2, since_ns=10 * NS_PER_S)
    line = Line()
    line.run(rough, until_ns=10 * NS_PER_S)
    assert line.buffer.delay_ns > 50 * NS_PER_MS
    line = Line()
    blocks = line.run(rough + calm)
    # Five seconds until the window is empty, and 25 ms less in each second from then on.
    settled = [b for b in blocks if b.payload is not None][-25:]
    delays = [b.play_ns - int.from_bytes(b.payload[2:], "big") * BLOCK_NS for b in settled]
    assert max(delays) <= 15 * NS_PER_MS
    assert line.buffer.counts.shortened > 50


def assert_gapless(blocks):
    """Each block begins where the one before ends, or later after a silence."""
    ends_ns = None
    for block in blocks:
        assert 0 <= abs(block.played_samples - block.samples) <= block.samples // 40
        if ends_ns is not None:
            # Rounding of the offset to whole nanoseconds.
            assert block.play_ns >= ends_ns - 1000
            yield block.play_ns - ends_ns
        ends_ns = block.play_ns + length_ns(block.played_samples)


@settings(max_examples=60, deadline=None)
@example(seed=19729783, jitter=76, loss=24, hiccup=127)
@example(seed=144, jitter=100, loss=3, hiccup=0)
@given(st.integers(0, 2**32), st.integers(1, 120), st.integers(0, 30), st.integers(0, 200))
def test_no_arrivals_cause_overlaps_or_unneeded_gaps(seed, jitter, loss, hiccup):
    rng = random.Random(seed)
    arrivals = [
        None if rng.randrange(100) < loss and n > 2 else arrival
        for n, arrival in enumerate(jittery(rng, 300, jitter))
    ]
    for n in range(3, 300):
        if arrivals[n] is not None and rng.randrange(40) == 0:
            arrivals[n] += rng.randrange(hiccup + 1) * NS_PER_MS
    line = Line()
    blocks = line.run(arrivals)
    row, longest = 0, 0
    gaps = [0, *assert_gapless(blocks)]
    for gap_ns, block in zip(gaps, blocks, strict=True):
        # A gap follows five concealments, or a burst in which the oldest blocks were dropped.
        if gap_ns > 1000:
            assert row >= 5 or line.buffer.counts.dropped
        row = row + 1 if block.payload is None else 0
        longest = max(longest, row)
    numbers = [n for n in heard(blocks) if n is not None]
    assert numbers == sorted(set(numbers)), "in order, and none twice"


def test_a_delayed_sound_is_stretched_and_shortened_again():
    line = Line()
    for n in range(600):
        until_ns = (n * 20 + 60) * NS_PER_MS if 100 <= n < 400 else None
        line.run([n * BLOCK_NS], [n], until_ns=n * BLOCK_NS + 1)
        line.buffer.hold((2**32 - 48_000 + n * 960) % 2**32, until_ns)
        if n == 399:
            assert 59 * NS_PER_MS <= line.buffer.delay_ns <= 61 * NS_PER_MS
    assert line.buffer.delay_ns <= 14 * NS_PER_MS
    assert list(assert_gapless(line.blocks))[-1] < 1000
    assert None not in heard(line.blocks)
    assert line.buffer.counts.stretched > 90


def test_a_copy_in_the_next_packet_is_used_if_present():
    # TOC of 20 ms SILK, and both flags of its first octet: voice activity, and a copy.
    line = Line(min_delay_ns=30 * NS_PER_MS)
    events = []
    for n in range(40):
        stamp = CaptureStamp(n * BLOCK_NS, n, "mic")
        (packet,) = line.sender.audio_packets(b"\x08\xc0" + n.to_bytes(2, "big"), stamp).packets
        if n not in (10, 20, 21):
            events.append((n * BLOCK_NS, packet))
    for arrival_ns, packet in events:
        line.advance(arrival_ns)
        line.receiver.handle_packet(packet, arrival_ns)
        line.pass_on()
    recovered = [b for b in line.blocks if b.recovered]
    assert [int.from_bytes(b.payload[2:], "big") for b in recovered] == [11, 22]
    assert (line.buffer.counts.recovered, line.buffer.counts.concealed) == (2, 1)


def test_a_lost_block_is_concealed_at_its_time():
    line = Line()
    blocks = line.run([None if n in (10, 20, 21) else n * BLOCK_NS for n in range(40)])
    assert heard(blocks)[:40] == [None if n in (10, 20, 21) else n for n in range(40)]
    times = [block.play_ns for block in blocks]
    assert {b - a for a, b in itertools.pairwise(times)} == {BLOCK_NS}


def test_silence_is_concealed_briefly_and_then_the_voice_continues():
    line = Line()
    sequences = list(range(20)) + list(range(120, 140))
    blocks = line.run([s * BLOCK_NS for s in sequences], sequences)
    assert heard(blocks)[:45] == [*range(20), *[None] * 5, *range(20, 40)]
    assert line.buffer.counts.concealed == 10  # five in the silence, five after the end
    assert blocks[25].play_ns - blocks[19].play_ns == 101 * BLOCK_NS


def test_after_a_stall_the_oldest_is_dropped_and_the_delay_stays_bounded():
    line = Line(max_delay_ns=200 * NS_PER_MS)
    # Blocks 50..124 arrive at once, up to 1.5 s late.
    arrivals = [max(n, 125) * BLOCK_NS + n if 50 <= n < 125 else n * BLOCK_NS for n in range(300)]
    blocks = line.run(arrivals)
    assert line.buffer.counts.late + line.buffer.counts.dropped > 40
    for block in blocks:
        if block.payload is not None:
            number = int.from_bytes(block.payload[2:], "big")
            if number >= 125:
                assert block.play_ns - number * BLOCK_NS <= 250 * NS_PER_MS
    assert heard(blocks)[-105:-5] == list(range(200, 300))


def test_the_buffer_is_bounded():
    line = Line(max_blocks=10, min_delay_ns=NS_PER_S, max_delay_ns=2 * NS_PER_S)
    line.run([n * BLOCK_NS for n in range(30)], until_ns=30 * BLOCK_NS)
    assert len(line.buffer) <= 10
    assert line.buffer.counts.dropped > 0


def test_garbage_and_a_new_time_line():
    line = Line()
    line.run([n * BLOCK_NS for n in range(10)])
    line.sender.ssrc = 6
    start_ns = 5 * NS_PER_S
    for n in range(10, 20):
        stamp = CaptureStamp(start_ns + n * BLOCK_NS, n + 10_000, "mic")
        (packet,) = line.sender.audio_packets(b"\x08\x80" + n.to_bytes(2, "big"), stamp).packets
        line.advance(start_ns + n * BLOCK_NS)
        line.receiver.handle_packet(packet, start_ns + n * BLOCK_NS)
        line.pass_on()
    line.advance(start_ns + NS_PER_S)
    assert [n for n in heard(line.blocks) if n is not None] == list(range(20))
    assert line.buffer.counts.resyncs == 1


def told(stamps, *, lost=(), jitter_ns=0, seed=0):
    """Play 20 ms blocks in time whose timestamps are `stamps`; the line, and its real blocks."""
    rng, line = random.Random(seed), Line()
    arrivals = []
    for number, stamp in enumerate(stamps):
        packet = pack_rtp(
            b"\x08\x80" + number.to_bytes(2, "big"),
            payload_type=97,
            marker=False,
            sequence=number,
            timestamp=stamp & 0xFFFF_FFFF,
            ssrc=5,
        )
        if number not in lost:
            arrivals.append((number * BLOCK_NS + rng.randint(0, jitter_ns), packet))
    for arrival_ns, packet in sorted(arrivals):
        line.advance(arrival_ns)
        line.receiver.handle_packet(packet, arrival_ns)
        line.pass_on()
    line.advance(len(stamps) * BLOCK_NS + NS_PER_S)
    return line, [block for block in line.blocks if block.payload is not None]


@settings(max_examples=60, deadline=None)
@given(
    st.lists(st.integers(-48, 48), min_size=100, max_size=200),
    st.booleans(),
    st.sets(st.integers(20, 80), max_size=6),
    st.sampled_from([0, 8 * NS_PER_MS, 25 * NS_PER_MS]),
    st.integers(0, 2**32 - 1),
)
def test_timestamps_that_waver_about_whole_blocks_tear_no_sound(off, walks, lost, jitter_ns, first):
    sums = list(itertools.accumulate(off)) if walks else off
    stamps = [first + number * 960 + away for number, away in enumerate(sums)]
    line, real = told(stamps, lost=lost, jitter_ns=jitter_ns)
    # Jitter alone costs some, until the delay is known.
    assert len(real) + line.buffer.counts.late + line.buffer.counts.dropped == len(off) - len(lost)
    assert line.buffer.counts.late + line.buffer.counts.dropped <= (5 if jitter_ns else 0)
    # Each is dated by its own timestamp.
    for block in real:
        number = int.from_bytes(block.payload[2:], "big")
        assert block.timestamp == stamps[number] & 0xFFFF_FFFF
    list(assert_gapless(line.blocks))


@given(st.sampled_from([-90_000, -30_000, -961, 12_000, 48_000, 91_200, 144_000]))
def test_timestamps_that_leap_although_no_time_has_passed_delay_and_drop_nothing(leap):
    stamps = [number * 960 + number // 100 * leap for number in range(500)]
    line, real = told(stamps)
    assert len(real) == 500
    assert line.buffer.delay_ns <= 15 * NS_PER_MS
    assert sum(block.payload is None for block in line.blocks[:-6]) == 0


@pytest.mark.parametrize(
    ("ms", "config", "blocks"), [(10, 0, 1), (20, 1, 1), (40, 2, 2), (60, 3, 3)]
)
def test_flags_of_pause_and_copy_follow_one_block_for_each_20_ms(ms, config, blocks):
    """RFC 6716 sections 4.2.3 and 4.2.4, in narrow band."""
    for pause, copy in itertools.product((False, True), repeat=2):
        flags = (0 if pause else 0x80) | (0x80 >> blocks if copy else 0)
        payload = bytes((config << 3, flags, 0))
        assert (is_pause(payload), holds_copy(payload)) == (pause, copy)


def direct(arrivals_ms, *, pauses=(), samples=960, **playout):
    """Packets of one length without a receiver before the buffer; what is played, and the buffer.

    arrivals_ms: by packet number.
    """
    buffer, blocks = PlayoutBuffer(**playout), []
    head = {960: 8, 2880: 24}[samples]
    for number, at_ms in sorted(arrivals_ms.items(), key=lambda one: (one[1], one[0])):
        payload = bytes((head, 0 if number in pauses else 0x80, number))
        timestamp = (2**32 - 5000 + number * samples) % 2**32
        packet = received(payload, number, timestamp=timestamp, received_ns=at_ms * NS_PER_MS)
        buffer.handle_packet(packet)
        blocks += iter(buffer.next_event, None)
    buffer.handle_timeout(packet.received_ns + NS_PER_S)
    return [*blocks, *iter(buffer.next_event, None)], buffer


def waits_ms(blocks, samples=960):
    """How long after its media time each block with a packet is played."""
    return [
        (block.play_ns - block.payload[2] * length_ns(samples)) / NS_PER_MS
        for block in blocks
        if block.payload
    ]


def test_a_new_buffer_is_silent():
    buffer = PlayoutBuffer()
    assert (buffer.poll_timeout(), buffer.delay_ns, len(buffer)) == (None, 0, 0)
    buffer.hold(5, 7)
    buffer.handle_packet(received(b"", 0))
    assert (buffer.counts.garbage, buffer.poll_timeout()) == (1, None)
    buffer.handle_packet(received(b"\x08\x80", 0, restart=True, received_ns=5))
    assert (buffer.poll_timeout(), len(buffer), buffer.counts.resyncs) == (10_000_005, 1, 0)


def test_the_delay_goes_down_by_a_fortieth_of_each_block_to_the_margin():
    blocks, buffer = direct({n: 20 * n for n in range(15)}, min_delay_ns=0)
    # The first one settles for 10 ms; the margin is 5 ms.
    assert waits_ms(blocks) == [max(10 - n / 2, 5) for n in range(15)]
    assert [block.played_samples for block in blocks[:15]] == [936] * 10 + [960] * 5
    assert buffer.counts.shortened == 10
    # Up to 3 ms too much stay, and a pause takes it away at once.
    blocks, _ = direct({n: 20 * n for n in range(15)}, min_delay_ns=7 * NS_PER_MS)
    assert waits_ms(blocks) == [10] * 15
    blocks, _ = direct({n: 20 * n for n in range(15)}, min_delay_ns=0, pauses={4})
    assert waits_ms(blocks) == [10, 9.5, 9, 8.5, 8] + [5] * 10
    blocks, _ = direct({n: 20 * n for n in range(9)}, min_delay_ns=0, margin_ns=0, pauses={1})
    assert [block.played_samples for block in blocks[:3]] == [936, 504, 960]


@pytest.mark.parametrize(
    ("late_allowed", "most_ms", "wait_ms"), [(0, 200, 35), (0, 20, 20), (60, 200, 10)]
)
def test_the_delay_is_that_of_the_jitter_and_5_ms(late_allowed, most_ms, wait_ms):
    arrivals = {n: 20 * n + 30 * (n % 4 == 3) for n in range(200)}
    blocks, buffer = direct(arrivals, late_allowed=late_allowed, max_delay_ns=most_ms * NS_PER_MS)
    assert buffer.delay_ns == pytest.approx(wait_ms * NS_PER_MS, abs=30_000)
    list(assert_gapless(blocks))


def test_lost_blocks_are_concealed_in_their_length_and_dated_on():
    arrivals = {n: 60 * n for n in range(12) if n not in (4, 5, 9)}
    blocks, buffer = direct(arrivals, samples=2880)
    first = 2**32 - 5000
    assert [block.timestamp for block in blocks[:12]] == [
        (first + 2880 * n) % 2**32 for n in range(12)
    ]
    assert [block.samples for block in blocks] == [2880] * 17
    assert [n for n, block in enumerate(blocks[:12]) if block.payload is None] == [4, 5, 9]
    assert buffer.poll_timeout() is None and buffer.counts.concealed == 3 + 5
    # Shorter blocks follow: only the time up to them is concealed.
    buffer = PlayoutBuffer(min_delay_ns=100 * NS_PER_MS)
    for number, timestamp, payload in (
        (0, 0, b"\x18\x80"), (1, 2880, b"\x18\x80"), (3, 6720, b"\x08\x80"), (4, 7680, b"\x08\x80"),
    ):  # fmt: skip
        buffer.handle_packet(
            received(payload, number, timestamp=timestamp, received_ns=length_ns(timestamp))
        )
    buffer.handle_timeout(length_ns(7680) + 110 * NS_PER_MS)
    assert [(block.timestamp, block.samples) for block in iter(buffer.next_event, None)] == [
        *((0, 2880), (2880, 2880), (5760, 960), (6720, 960), (7680, 960))
    ]


def test_a_longer_path_is_met_by_inserted_steps_of_2500_us():
    arrivals = {n: 20 * n + 30 * (n >= 10) for n in range(20)}
    blocks, buffer = direct(arrivals)
    inserted = [block for block in blocks if block.inserted]
    assert inserted and all(block.played_samples == block.samples for block in inserted)
    assert all(block.samples % 120 == 0 and block.samples <= 960 for block in inserted)
    # Each is dated as the block that it goes before.
    following = {id(one): other for one, other in itertools.pairwise(blocks)}
    assert all(following[id(block)].timestamp == block.timestamp for block in inserted)
    assert 30 < waits_ms(blocks)[-1] <= 35
    list(assert_gapless(blocks))
    assert buffer.counts.late + buffer.counts.played == 20


def test_two_seconds_of_another_time_are_a_new_time_line():
    for away_ms, resyncs in ((1990, 0), (2010, 1), (-2010, 1)):
        _, buffer = direct({n: 3000 + 20 * n + away_ms * (n >= 5) for n in range(8)})
        assert buffer.counts.resyncs == resyncs

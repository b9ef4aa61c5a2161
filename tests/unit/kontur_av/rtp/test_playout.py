"""The jitter buffer: timing, order, missing packets, and how late a voice is heard."""

import itertools
import random

import pytest
from common import repeats
from hypothesis import example, given, settings
from hypothesis import strategies as st
from rtp_packets import received

from kontur_av.clock import NS_PER_MS as MS
from kontur_av.clock import NS_PER_S
from kontur_av.rtp.playout import PlayoutBuffer
from kontur_av.rtp.receiver import RtpReceiver
from kontur_av.rtp.wire import pack_rtp

BLOCK_NS = 20 * MS
FIRST_TIMESTAMP = 2**32 - 48_000
#: Rounding of an offset to whole nanoseconds.
ROUNDING_NS = 1000
#: TOC octets of SILK, by the length of a block in samples.
HEADS = {960: 8, 2880: 24}


class Line:
    """A voice through a network: packets go in, blocks come out at their time.

    direct: without a receiver, which waits for a second packet before it believes the first.
    """

    def __init__(self, *, direct=False, samples=960, **playout):
        self.buffer = PlayoutBuffer(**playout)
        self.counts = self.buffer.counts
        self.receiver = None
        if not direct:
            self.receiver = RtpReceiver(payload_type=97, clock_rate_hz=48_000, ordered=False)
        self.samples, self.ssrc, self.sequence, self.blocks = samples, 5, 65_500, []

    def run(self, arrivals, at=None, until_ns=None, *, pauses=(), copies=False, stamps=None):
        """Send a block for each arrival in ns, None if it is lost; return all blocks so far.

        at: the place of each block in time, counted in blocks. stamps: the timestamps instead.
        until_ns: until then the line is heard; one second after the last arrival.
        """
        packets = []
        for number, arrival_ns in enumerate(arrivals):
            self.sequence += 1
            place = number if at is None else at[number]
            stamp = FIRST_TIMESTAMP + place * self.samples if stamps is None else stamps[number]
            # Flags of voice activity and of a copy, the number of the block.
            flags = (0 if number in pauses else 0x80) | (0x40 if copies else 0)
            payload = bytes((HEADS[self.samples], flags)) + number.to_bytes(2, "big")
            if arrival_ns is not None:
                packets.append((arrival_ns, self.sequence, stamp & 0xFFFF_FFFF, payload))
        for packet in sorted(packets):
            self.advance(packet[0])
            for event in self._received(*packet):
                self.buffer.handle_packet(event)
            self._drain()
        self.advance(until_ns or max(packets)[0] + NS_PER_S)
        return self.blocks

    def _received(self, now_ns, sequence, timestamp, payload):
        if self.receiver is None:
            return [received(payload, sequence, timestamp=timestamp, received_ns=now_ns)]
        fields = {"sequence": sequence & 0xFFFF, "timestamp": timestamp, "ssrc": self.ssrc}
        self.receiver.handle_packet(
            pack_rtp(payload, payload_type=97, marker=False, **fields), now_ns
        )
        return iter(self.receiver.next_event, None)

    def advance(self, now_ns):
        while (due_ns := self.buffer.poll_timeout()) is not None and due_ns <= now_ns:
            self.buffer.handle_timeout(due_ns)
            self._drain()

    def _drain(self):
        self.blocks += iter(self.buffer.next_event, None)


def heard(blocks) -> list:
    """Return the number of each block, None for one without a packet."""
    return [b.payload and int.from_bytes(b.payload[2:], "big") for b in blocks]


def real(blocks) -> list:
    return [number for number in heard(blocks) if number is not None]


def delays(blocks) -> dict:
    """Return by its number how long after its media time each block is played."""
    pairs = zip(heard(blocks), blocks, strict=True)
    return {n: block.play_ns - n * BLOCK_NS for n, block in pairs if n is not None}


def waits_ms(blocks) -> list:
    return [ns / MS for ns in delays(blocks).values()]


def gaps(blocks) -> list:
    """Return the silence before each block but the first; no block begins before one ends."""
    for block in blocks:
        assert abs(block.played_samples - block.samples) <= block.samples // 40
    found = [
        other.play_ns - one.play_ns - one.played_samples * NS_PER_S // 48_000
        for one, other in itertools.pairwise(blocks)
    ]
    assert min(found) >= -ROUNDING_NS
    return found


def steps(blocks) -> set:
    return {b.play_ns - a.play_ns for a, b in itertools.pairwise(blocks)}


def steady(count, late=lambda number: 0) -> list:
    """Return arrivals in time, some of them later by ms."""
    return [n * BLOCK_NS + late(n) * MS for n in range(count)]


def jittery(rng, count, jitter_ms, since_ns=0) -> list:
    return [since_ns + n * BLOCK_NS + rng.randrange(jitter_ms * MS) for n in range(count)]


def bunched(count, *first) -> list:
    """Return arrivals of which at some places three come together, the first of them 45 ms late."""
    together = {n + k: n * 20 + 45 for n in first for k in range(3)}
    return [together.get(n, n * 20) * MS for n in range(count)]


def in_time(*spans):
    """Return the places of these spans of blocks, and arrivals in time."""
    at = [place for span in spans for place in range(*span)]
    return at, [place * BLOCK_NS for place in at]


def test_a_steady_voice_is_played_at_a_steady_pace_across_wrap_around():
    line = Line()
    blocks = line.run(steady(100))
    assert heard(blocks)[:100] == list(range(100)) and steps(blocks) == {BLOCK_NS}
    # Without a report the first block waits for the second (probation), then for the least delay.
    assert line.buffer.delay_ns <= 30 * MS
    assert line.counts.late == 0


def test_rare_stalls_do_not_raise_the_delay():
    arrivals = bunched(1000, *range(50, 1000, 250))
    blocks = Line().run(arrivals, until_ns=arrivals[-1] + 5 * MS)
    assert {b.play_ns - n * BLOCK_NS for n, b in enumerate(blocks)} == {10 * MS}
    assert heard(blocks).count(None) == 2 * 4


def test_frequent_lateness_raises_the_delay():
    line = Line(late_allowed=2)
    arrivals = steady(260, lambda n: 12 * (n in range(50, 200, 20)))
    blocks = line.run(arrivals, until_ns=arrivals[-1] + 5 * MS)
    # Two are concealed and dropped; the third is played after its own concealment.
    assert real(blocks)[:240] == [n for n in range(242) if n not in (50, 70)]
    assert (line.counts.late, line.counts.concealed, line.counts.inserted) == (2, 2, 1)
    # 12 ms and the margin of 5; additional delay has been removed by time compression.
    assert 17 * MS <= line.buffer.delay_ns <= 20 * MS
    # What a stall lacks is inserted at once.
    arrivals, line = bunched(100, 50, 90), Line(late_allowed=1)
    blocks = line.run(arrivals, until_ns=arrivals[-1] + MS)
    assert line.buffer.delay_ns >= 40 * MS
    assert line.counts.inserted >= 1 and max(gaps(blocks)) < ROUNDING_NS


def test_a_queue_before_the_start_does_not_delay_later_blocks():
    # Everything up to 70 ms arrives at once; from the fourth block on nothing waits.
    arrivals = [max(n * 20, 70 + n // 3) * MS for n in range(100)]
    blocks = Line().run(arrivals, until_ns=arrivals[-1] + 5 * MS)
    numbers, waits = heard(blocks), waits_ms(blocks)
    assert numbers == list(range(numbers[0], 99)) and numbers[0] <= 4
    assert blocks[0].play_ns <= 100 * MS
    assert max(waits) <= 22 and set(waits[30:]) == {10}
    # Fifteen blocks at once, 300 ms of sound: more than the largest delay.
    arrivals, line = [max(n * 20, 290) * MS + n for n in range(60)], Line()
    blocks = line.run(arrivals, until_ns=arrivals[-1] + 5 * MS)
    numbers = real(blocks)
    assert numbers == list(range(numbers[0], numbers[-1] + 1))
    assert 5 <= numbers[0] == line.counts.dropped <= 6
    # It is played 200 ms after the media time, the largest delay, and 0.5 ms less with each block.
    assert numbers[-1] >= 48 and max(gaps(blocks)) < ROUNDING_NS


def test_packets_that_are_reordered_after_a_silence_are_played_in_order():
    at, arrivals = in_time((20,), (60, 80))
    arrivals[20] = arrivals[21] + MS
    line = Line()
    assert real(line.run(arrivals, at)) == list(range(40))
    assert line.counts.late == line.counts.dropped == 0


def test_a_voice_begins_after_a_burst_in_which_all_was_too_old():
    # After a silence two blocks come 300 ms late, the later one first.
    at, arrivals = in_time((20,), (60, 62), (80, 95))
    arrivals[20:22] = [arrivals[20] + late_ms * MS for late_ms in (305, 300)]
    line = Line(max_delay_ns=60 * MS)
    blocks = line.run(arrivals, at)
    assert real(blocks) == [*range(20), *range(22, 37)]
    assert (line.counts.dropped, line.counts.late) == (1, 1)
    gaps(blocks)


def test_every_block_counts_once_as_what_it_was_played_as():
    arrivals = jittery(random.Random(11), 400, 90)
    arrivals = [None if n % 17 == 5 else at for n, at in enumerate(arrivals)]
    line = Line()
    blocks, counts = line.run(arrivals), line.counts
    longer = sum(b.played_samples > b.samples for b in blocks)
    shorter = sum(b.played_samples < b.samples for b in blocks)
    assert counts.played == len(real(blocks))
    assert counts.inserted + counts.concealed == len(blocks) - counts.played
    assert (counts.stretched, counts.shortened) == (longer, shorter)
    assert counts.played + counts.late + counts.dropped == 400 - arrivals.count(None)
    assert min(counts.inserted, counts.concealed, counts.late, longer, shorter) > 0


def test_the_delay_follows_the_jitter_down_within_seconds_and_in_a_pause_at_once():
    # Two hundred and fifty blocks are late; the following ones are not, and soon there is a pause.
    arrivals = steady(400, lambda n: 60 * (60 <= n < 310))
    line, pauses = Line(window_ns=NS_PER_S), range(365, 375)
    blocks = line.run(arrivals, until_ns=arrivals[-1] + MS, pauses=pauses)
    found = delays(blocks)
    assert found[364] >= 55 * MS and found[372] <= 15 * MS
    assert 480 <= min(b.played_samples for b in blocks) < 936
    rng, line = random.Random(3), Line()
    line.run(jittery(rng, 500, 60), until_ns=10 * NS_PER_S)
    assert line.buffer.delay_ns > 50 * MS
    calm = jittery(rng, 450, 2, since_ns=10 * NS_PER_S)
    settled = line.run(calm, range(500, 950))[-30:-5]
    # Five seconds until the window is empty, and 25 ms less in each second from then on.
    assert max(waits_ms(settled)) <= 15 + 10_000
    assert line.counts.shortened > 50


def test_another_time_line_and_another_source_begin_anew_after_the_end_of_the_old_one():
    line = Line()
    later = [at + 50 * MS for at in steady(200)[100:]]
    gaps(line.run(jittery(random.Random(5), 100, 60) + later, [*range(100), *range(5100, 5200)]))
    assert line.counts.resyncs == 1
    line = Line()
    line.run(steady(10))
    line.ssrc = 6
    blocks = line.run([5 * NS_PER_S + at for at in steady(10)], range(10_250, 10_260))
    assert real(blocks) == [*range(10), *range(10)]
    assert line.counts.resyncs == 1
    for away_ms, resyncs in ((1990, 0), (2010, 1), (-2010, 1)):
        line = Line(direct=True)
        line.run([(3000 + 20 * n + away_ms * (n >= 5)) * MS for n in range(8)])
        assert line.counts.resyncs == resyncs


@settings(max_examples=repeats(60), deadline=None)
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
            arrivals[n] += rng.randrange(hiccup + 1) * MS
    line = Line()
    blocks = line.run(arrivals)
    row = 0
    for gap_ns, block in zip([0, *gaps(blocks)], blocks, strict=True):
        # A gap follows five concealments, or a burst in which the oldest blocks were dropped.
        assert gap_ns <= ROUNDING_NS or row >= 5 or line.counts.dropped
        row = row + 1 if block.payload is None else 0
    assert real(blocks) == sorted(set(real(blocks))), "in order, and none twice"


def test_a_delayed_sound_is_stretched_and_shortened_again():
    line = Line()
    for n in range(600):
        until_ns = (n * 20 + 60) * MS if 100 <= n < 400 else None
        blocks = line.run([n * BLOCK_NS], [n], until_ns=n * BLOCK_NS + 1)
        line.buffer.hold((FIRST_TIMESTAMP + n * 960) % 2**32, until_ns)
        if n == 399:
            assert 59 * MS <= line.buffer.delay_ns <= 61 * MS
    assert line.buffer.delay_ns <= 14 * MS
    assert gaps(blocks)[-1] < ROUNDING_NS
    assert None not in heard(blocks)
    assert line.counts.stretched > 90


def test_a_lost_block_is_concealed_at_its_time_or_taken_from_the_copy_in_the_next():
    arrivals = [None if n in (10, 20, 21) else at for n, at in enumerate(steady(40))]
    blocks = Line().run(arrivals)
    assert heard(blocks)[:40] == [None if n in (10, 20, 21) else n for n in range(40)]
    assert steps(blocks) == {BLOCK_NS}
    line = Line(min_delay_ns=30 * MS)
    blocks = line.run(arrivals, until_ns=39 * BLOCK_NS, copies=True)
    assert real(block for block in blocks if block.recovered) == [11, 22]
    assert (line.counts.recovered, line.counts.concealed) == (2, 1)


def test_silence_is_concealed_briefly_and_then_the_voice_continues():
    line, (at, arrivals) = Line(), in_time((20,), (120, 140))
    blocks = line.run(arrivals, at)
    assert heard(blocks)[:45] == [*range(20), *[None] * 5, *range(20, 40)]
    assert line.counts.concealed == 10  # five in the silence, five after the end
    assert blocks[25].play_ns - blocks[19].play_ns == 101 * BLOCK_NS
    # Each silence counts for itself.
    line, (at, arrivals) = Line(max_concealed=3), in_time((20,), (60, 80), (120, 140))
    found = heard(line.run(arrivals, at))
    assert found[20:23] == [None] * 3 and found[43:46] == [None] * 3
    assert (line.counts.concealed, line.buffer.poll_timeout()) == (9, None)


@pytest.mark.rule("4")
def test_after_a_stall_the_oldest_is_dropped_and_the_delay_stays_bounded():
    line = Line(max_delay_ns=200 * MS)
    # Blocks 50..124 arrive at once, up to 1.5 s late.
    blocks = line.run([125 * BLOCK_NS + n if 50 <= n < 125 else n * BLOCK_NS for n in range(300)])
    assert line.counts.late + line.counts.dropped > 40
    assert max(ns for number, ns in delays(blocks).items() if number >= 125) <= 250 * MS
    assert heard(blocks)[-105:-5] == list(range(200, 300))


@pytest.mark.rule("4")
def test_the_buffer_is_bounded():
    line = Line(max_blocks=10, min_delay_ns=NS_PER_S, max_delay_ns=2 * NS_PER_S)
    line.run(steady(30), until_ns=30 * BLOCK_NS)
    assert len(line.buffer) <= 10 and line.counts.dropped > 0


@settings(max_examples=repeats(60), deadline=None)
@given(
    st.lists(st.integers(-48, 48), min_size=100, max_size=200),
    st.booleans(),
    st.sets(st.integers(20, 80), max_size=6),
    st.sampled_from([0, 8 * MS, 25 * MS]),
    st.integers(0, 2**32 - 1),
)
def test_timestamps_that_waver_about_whole_blocks_tear_no_sound(off, walks, lost, jitter_ns, first):
    sums = list(itertools.accumulate(off)) if walks else off
    stamps = [first + number * 960 + away for number, away in enumerate(sums)]
    rng, line = random.Random(0), Line()
    late_ns = [rng.randint(0, jitter_ns) for _ in stamps]
    arrivals = [None if n in lost else n * BLOCK_NS + late for n, late in enumerate(late_ns)]
    played = [block for block in line.run(arrivals, stamps=stamps) if block.payload is not None]
    # Jitter alone costs some, until the delay is known.
    missed = line.counts.late + line.counts.dropped
    assert len(played) + missed == len(off) - len(lost)
    assert missed <= (5 if jitter_ns else 0)
    # Each is dated by its own timestamp.
    for number, block in zip(heard(played), played, strict=True):
        assert block.timestamp == stamps[number] & 0xFFFF_FFFF
    # A concealed one is dated on from the block before it.
    for block, following in itertools.pairwise(line.blocks):
        if block.payload is not None and following.payload is None and not following.inserted:
            step = (following.timestamp - block.timestamp) % 2**32
            assert abs((step + 2**31) % 2**32 - 2**31 - 960) < 400
    gaps(line.blocks)


@pytest.mark.parametrize("leap", [-90_000, -30_000, -961, 12_000, 48_000, 91_200, 144_000])
def test_timestamps_that_leap_although_no_time_has_passed_delay_and_drop_nothing(leap):
    line = Line()
    stamps = [number * 960 + number // 100 * leap for number in range(500)]
    found = heard(line.run(steady(500), stamps=stamps))
    assert [number for number in found if number is not None] == list(range(500))
    assert line.buffer.delay_ns <= 15 * MS
    assert None not in found[:-6]


def test_a_new_buffer_is_silent():
    buffer = PlayoutBuffer()
    assert (buffer.poll_timeout(), buffer.delay_ns, len(buffer)) == (None, 0, 0)
    buffer.hold(5, 7)
    buffer.handle_packet(received(b"", 0))
    assert (buffer.counts.garbage, buffer.poll_timeout()) == (1, None)
    buffer.handle_packet(received(b"\x08\x80", 0, restart=True, received_ns=5))
    assert (buffer.poll_timeout(), len(buffer), buffer.counts.resyncs) == (10_000_005, 1, 0)


def test_the_delay_goes_down_by_a_fortieth_of_each_block_to_the_margin():
    def fifteen(pauses=(), **playout):
        line = Line(direct=True, **playout)
        return line.run(steady(15), pauses=pauses), line.counts

    blocks, counts = fifteen(min_delay_ns=0)
    # The first one settles for 10 ms; the margin is 5 ms.
    assert waits_ms(blocks) == [max(10 - n / 2, 5) for n in range(15)]
    assert [block.played_samples for block in blocks[:15]] == [936] * 10 + [960] * 5
    assert counts.shortened == 10
    # Up to 3 ms too much stay, and a pause takes it away at once.
    assert waits_ms(fifteen(min_delay_ns=7 * MS)[0]) == [10] * 15
    assert waits_ms(fifteen({4}, min_delay_ns=0)[0]) == [10, 9.5, 9, 8.5, 8] + [5] * 10
    blocks, _ = fifteen({1}, min_delay_ns=0, margin_ns=0)
    assert [block.played_samples for block in blocks[:3]] == [936, 504, 960]


@pytest.mark.parametrize(
    ("late_allowed", "most_ms", "wait_ms"), [(0, 200, 35), (0, 20, 20), (60, 200, 10)]
)
def test_the_delay_is_that_of_the_jitter_and_5_ms(late_allowed, most_ms, wait_ms):
    line = Line(direct=True, late_allowed=late_allowed, max_delay_ns=most_ms * MS)
    gaps(line.run(steady(200, lambda n: 30 * (n % 4 == 3))))
    assert line.buffer.delay_ns == pytest.approx(wait_ms * MS, abs=30_000)


def test_lost_blocks_are_concealed_in_their_length_and_dated_on():
    line = Line(direct=True, samples=2880)
    arrivals, at = [None if n in (4, 5, 9) else 60 * n * MS for n in range(12)], range(12, 24)
    blocks = line.run(arrivals, at)
    assert [block.timestamp for block in blocks[:12]] == [
        (FIRST_TIMESTAMP + 2880 * place) % 2**32 for place in at
    ]
    assert [block.samples for block in blocks] == [2880] * 17
    assert [n for n, block in enumerate(blocks[:12]) if block.payload is None] == [4, 5, 9]
    assert line.buffer.poll_timeout() is None and line.counts.concealed == 3 + 5
    # Shorter blocks follow: only the time up to them is concealed.
    buffer = PlayoutBuffer(min_delay_ns=100 * MS)
    for number, ms, head in ((0, 0, 24), (1, 60, 24), (3, 140, 8), (4, 160, 8)):
        packet = received(bytes((head, 0x80)), number, timestamp=48 * ms, received_ns=ms * MS)
        buffer.handle_packet(packet)
    buffer.handle_timeout(270 * MS)
    assert [(block.timestamp, block.samples) for block in iter(buffer.next_event, None)] == [
        *((0, 2880), (2880, 2880), (5760, 960), (6720, 960), (7680, 960))
    ]


def test_a_longer_path_is_met_by_inserted_steps_of_2500_us():
    line = Line(direct=True)
    blocks = line.run(steady(20, lambda n: 30 * (n >= 10)))
    inserted = [pair for pair in itertools.pairwise(blocks) if pair[0].inserted]
    assert inserted
    for block, following in inserted:
        assert block.played_samples == block.samples <= 960 and block.samples % 120 == 0
        # It is dated as the block that it goes before.
        assert following.timestamp == block.timestamp
    assert 30 < waits_ms(blocks)[-1] <= 35
    gaps(blocks)
    assert line.counts.late + line.counts.played == 20

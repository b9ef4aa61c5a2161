"""Which context is used when: two-way, one-way, after gaps, restarts and source changes.

For any source and any loss, no header is restored wrongly: `Path.send` checks all that comes out.
"""

from itertools import islice, pairwise
from random import Random

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from link_header_sources import SLOT_NS, Path, rtp, video, voice

from telepresence.link.compression.header_compression import (
    FIRST_WHOLE,
    FLEETING_LIFE_NS,
    LIFE_NS,
    MOST_POSSIBLE,
    RtpCompressor,
    RtpDecompressor,
    RtpSource,
)
from telepresence.link.compression.rtp_forms import KIND_BARE, KIND_CONTEXT, KIND_RAW, RtpForms
from telepresence.link.flows import video_flow, voice_flow

FORMS = RtpForms(video_flow("video"), 1_000_000)
SHORT = 1
VIDEO, VOICE = video_flow("video"), voice_flow("voice")
FLEETING_SLOTS, LIFE_SLOTS = FLEETING_LIFE_NS // SLOT_NS, LIFE_NS // SLOT_NS
FLOWS = pytest.mark.parametrize("flow", [VIDEO, VOICE], ids=["video", "voice"])
HEARD = pytest.mark.parametrize("heard", [True, False], ids=["two-way", "one-way"])
#: Largest mean cost of each source in octets a packet, with tag, contexts and first packets.
SOURCES = {
    "down, on its grid": (VIDEO, 2.0, lambda r: video(r, 60, packets=(3,), wait_ms=(8, 12))),
    "down, 2 to 4 packets": (VIDEO, 2.2, lambda r: video(r, 60, packets=(2, 3, 3, 3, 4))),
    "up, on its grid": (VIDEO, 1.6, lambda r: video(r, 60)),
    "up, 23.976 Hz": (VIDEO, 2.2, lambda r: video(r, 60, hz=24_000 / 1001)),
    "up, jitter 1 ms": (VIDEO, 2.2, lambda r: video(r, 60, jitter_ms=1)),
    "up, its clock 200 ppm off": (VIDEO, 2.0, lambda r: video(r, 60, ppm=200)),
    "up, pictures left out": (VIDEO, 2.0, lambda r: video(r, 60, skip=0.02)),
    "up, on no grid": (VIDEO, 3.4, lambda r: video(r, 60, jitter_ms=16)),
    "voice, its clock 200 ppm off": (VOICE, 1.2, lambda r: voice(r, 60, ppm=-200)),
    "voice, blocks of 10 ms": (VOICE, 1.2, lambda r: voice(r, 60, block_ms=10)),
    "voice, blocks of 60 ms": (VOICE, 1.4, lambda r: voice(r, 60, block_ms=60)),
}


@pytest.mark.parametrize(("flow", "most", "source"), SOURCES.values(), ids=SOURCES)
def test_headers_cost_two_octets_on_average(flow, most, source):
    path = Path(flow)
    for count, packet in source(Random(1)):
        path.send(count, packet)
    assert all(exact for _, _, exact in path.outcomes)
    print(f"{path.octets_a_packet():.2f}", path.compressor.report())
    assert path.octets_a_packet() <= most


def test_whole_headers_come_until_a_context_is_held_and_one_way_a_few():
    path = Path(VOICE)
    kinds = [path.send(count, packet, delay_slots=800) for count, packet in voice(Random(1), 3)]
    assert KIND_BARE not in kinds[:40]
    assert kinds[50:] == [KIND_BARE] * 100
    path = Path(VOICE, heard=False)
    kinds = [path.send(*item) for item in islice(voice(Random(1), 1, jitter_ms=0), 6)]
    whole = [KIND_CONTEXT] + [KIND_RAW] * (FIRST_WHOLE - 1)
    assert kinds == whole + [KIND_BARE] * 3


def test_whole_headers_again_as_soon_as_the_peers_new_life_is_known():
    path, source = Path(VOICE), voice(Random(1), 2)
    assert [path.send(*next(source)) for _ in range(30)][-1] == KIND_BARE
    path.compressor.forget()
    assert path.send(*next(source)) in (KIND_RAW, KIND_CONTEXT)


def test_a_number_that_may_still_be_acknowledged_is_not_reused():
    """The peer holds an old context and receives nothing more, while hundreds follow."""
    compressor = RtpCompressor(VOICE, SLOT_NS)
    compressor.handle_peer(heard=True)
    given = []
    for number in range(9000):
        count = number * 3300
        # A packet of each 165th block; the others were left out.
        kind, body, _ = compressor.compress(rtp(number * 165, count * 48), count)
        if kind == KIND_CONTEXT:
            given.append(body[0])
        compressor.handle_acknowledgement(given[0], count)
    assert len(given) > 900
    assert set(given[1:]) == set(range(1, 256)) - {given[0]}


def plain(timestamp, *, hz=30, seconds=60, ssrcs=1, extended=0):
    """Return (count, packet) of `hz` packets a second, each a millisecond after its instant.

    ssrcs: sources that take turns. extended: packets of ten that have an extension.
    """
    random = Random(1)
    for number in range(hz * seconds):
        packet = rtp(number // ssrcs, timestamp(number, random), ssrc=number % ssrcs)
        first = b"\x90" if number % 10 < extended else b"\x80"
        yield 1000 + number * 1000 // hz, first + packet[1:]


def drawn(_, random):
    return random.randrange(1 << 32)


NEVER_GAINING = {
    "constant timestamps": (VIDEO, lambda: plain(lambda *_: 12_345)),
    "random timestamps": (VIDEO, lambda: plain(drawn)),
    "two SSRCs": (VOICE, lambda: plain(lambda number, _: number // 2 * 3000, hz=50, ssrcs=2)),
    "extensions": (VIDEO, lambda: plain(drawn, extended=9)),
    "8 kHz in a voice flow": (VOICE, lambda: plain(lambda number, _: number * 160, hz=50)),
}


@pytest.mark.parametrize(("heard", "delay_slots"), [(True, 40), (True, 800), (False, 0)])
@pytest.mark.parametrize(("flow", "source"), NEVER_GAINING.values(), ids=NEVER_GAINING)
def test_a_source_that_never_gains_costs_its_raw_headers(flow, source, heard, delay_slots):
    path = Path(flow, heard=heard)
    for count, packet in source():
        path.send(count, packet, delay_slots=delay_slots)
    assert path.octets_a_packet() <= 13.05
    assert all(exact for _, _, exact in path.outcomes)


@HEARD
def test_a_source_that_becomes_regular_gets_contexts_again(heard):
    path = Path(VIDEO, heard=heard)
    for count, packet in plain(drawn):
        path.send(count, packet)
    later = count
    kinds = [path.send(later + count, packet) for count, packet in video(Random(2), 60)]
    contexts = [number for number, kind in enumerate(kinds) if kind == KIND_CONTEXT]
    assert contexts[0] < 30 * 2
    assert all(kind >= KIND_BARE or kind == KIND_CONTEXT for kind in kinds[30 * 20 :])


def test_contexts_that_an_acknowledgement_shows_as_lost_make_room_for_others():
    """Contexts sent long before it, and after the one it names, are no longer possible."""
    compressor = RtpCompressor(VOICE, SLOT_NS)
    compressor.handle_peer(heard=True)
    sent = {}
    source = list(voice(Random(1), 3, jitter_ms=0)) + [
        (count + 4000, packet) for count, packet in voice(Random(2), 100, jitter_ms=0)
    ]
    later = source[-2:]
    for count, packet in source[:-2]:
        kind, body, _ = compressor.compress(packet, count)
        if kind == KIND_CONTEXT:
            sent[count] = body[0]
        # All contexts of the new source are lost; the sender keeps trying.
        compressor.handle_acknowledgement(next(iter(sent.values())), count)
    assert len(sent) > MOST_POSSIBLE
    assert max(sent) > count - 4000
    # One of them was held after all, and is named too late, or as late as possible.
    for old_ms, believed in ((34_000, False), (30_000, True)):
        late = next(number for at, number in sent.items() if at > count - old_ms)
        compressor.handle_acknowledgement(late, count)
        count, packet = later.pop(0)
        assert (compressor.compress(packet, count)[0] >= KIND_BARE) == believed


@pytest.mark.parametrize(("heard", "slots"), [(True, LIFE_SLOTS), (False, FLEETING_SLOTS)])
def test_a_context_expires_at_the_receiver(heard, slots):
    compressor, decompressor = RtpCompressor(VOICE, SLOT_NS), RtpDecompressor(VOICE, SLOT_NS)
    compressor.handle_peer(heard=heard)
    kind, body, _ = compressor.compress(rtp(0, 0), 0)
    assert kind == KIND_CONTEXT
    decompressor.decompress(kind, body, 0)
    assert decompressor.context_id == int(heard)
    assert isinstance(decompressor.decompress(KIND_BARE, b"", slots), bytes)
    assert decompressor.decompress(KIND_BARE, b"", slots + 1) == "no_context"


@pytest.mark.parametrize("first", [LIFE_SLOTS - 700, LIFE_SLOTS, LIFE_SLOTS + 1])
def test_a_sender_compresses_as_long_as_the_receiver_holds_the_context(first):
    """Of all contexts the first one alone arrives; `first`: a frame in which a packet starts."""
    compressor, decompressor = RtpCompressor(VOICE, SLOT_NS), RtpDecompressor(VOICE, SLOT_NS)
    compressor.handle_peer(heard=True)
    compressed = []
    for count in sorted({0, *range(first % 1000, LIFE_SLOTS + 20_000, 1000)}):
        packet = rtp(count // 20, count // 20 * 960)
        kind, body, _ = compressor.compress(packet, count)
        if kind != KIND_CONTEXT or count == 0:
            assert decompressor.decompress(kind, body, count) == packet
        if kind >= KIND_BARE:
            compressed.append(count)
        compressor.handle_acknowledgement(decompressor.context_id, count)
    assert LIFE_SLOTS - 8_000 < compressed[-1] <= LIFE_SLOTS


@pytest.mark.parametrize(("pause", "whole"), [(FLEETING_SLOTS, 2), (FLEETING_SLOTS + 1, 3)])
def test_one_way_a_receiver_holds_none_after_a_long_pause(pause, whole):
    """Then as many whole headers come first as at the beginning."""
    path = Path(VOICE, heard=False)
    assert path.send(0, rtp(0, 0)) == KIND_CONTEXT
    kinds = [
        path.send(pause + number * 20, rtp(9_000 + number, 777_777 + number * 960))
        for number in range(20)
    ]
    assert whole == next(number for number, kind in enumerate(kinds) if kind >= KIND_BARE)


@pytest.mark.parametrize(
    "first_octets",
    [b"\x81\x60", b"\x90\x60", b"\xa0\x60", b"\x60\x60"],
    ids=["csrc", "extension", "padding", "version"],
)
def test_other_headers_are_sent_unchanged(first_octets):
    compressor, decompressor = RtpCompressor(VIDEO, SLOT_NS), RtpDecompressor(VIDEO, SLOT_NS)
    packet = first_octets + bytes(30)
    assert compressor.compress(packet, 0) == (KIND_RAW, packet, 12)
    assert decompressor.decompress(KIND_RAW, packet, 0) == packet
    assert compressor.compress(b"short", 0) == (KIND_RAW, b"short", 5)


def test_garbage_is_reported_in_one_word():
    decompressor = RtpDecompressor(VIDEO, SLOT_NS)
    assert decompressor.decompress(0, bytes(40), 0) == "malformed"
    assert decompressor.decompress(KIND_CONTEXT, bytes(18), 0) == "malformed"
    assert decompressor.decompress(KIND_CONTEXT, bytes(40), 0) == "malformed"  # period 0
    assert decompressor.decompress(KIND_BARE, b"", 0) == "no_context"
    _, body, _ = RtpCompressor(VOICE, SLOT_NS).compress(rtp(1, 2), 0)
    assert decompressor.decompress(KIND_CONTEXT, body, 0) == rtp(1, 2)
    assert decompressor.decompress(5, b"", 0) == "malformed"
    assert decompressor.decompress(8, b"", 0) == "malformed"
    assert decompressor.decompress(12, b"1", 0) == "malformed"


def blocks(seconds):
    return range(0, seconds * 1000, 20)


def steady_voice(seconds):
    return [(count, rtp(count // 20, count * 48, payload_type=97)) for count in blocks(seconds)]


@pytest.mark.parametrize(("jitter_ms", "pictures"), [(0, 5), (1, 33)])
def test_one_way_no_context_before_the_source_is_known(jitter_ms, pictures):
    """Nobody would replace a bad one: it would serve for its whole lifetime."""
    packets = list(video(Random(4), 3, jitter_ms=jitter_ms, wait_ms=(8, 8)))
    one_way = Path(VIDEO, heard=False)
    kinds = [one_way.send(*item) for item in packets]
    assert kinds.index(KIND_CONTEXT) == pictures - 1
    assert set(kinds[: pictures - 1]) == {KIND_RAW}
    two_way = Path(VIDEO)
    assert two_way.send(*packets[0]) == KIND_CONTEXT


@pytest.mark.parametrize("answers", [False, True])
def test_contexts_that_are_not_acknowledged_follow_after_twice_the_time_each(answers):
    """answers: the peer says that it holds none, so the sender goes on trying."""
    compressor, counts = RtpCompressor(VOICE, SLOT_NS), []
    compressor.handle_peer(heard=True)
    for count, packet in steady_voice(120):
        if answers:
            compressor.handle_acknowledgement(0, count)
        if compressor.compress(packet, count)[0] == KIND_CONTEXT:
            counts.append(count)
    distances = [later - earlier for earlier, later in pairwise(counts)]
    most = len(distances) if answers else MOST_POSSIBLE - 1
    assert distances == [100, 200, 400, 800, 1600] + [3200] * (most - 5)
    assert (counts[-1] > 110_000) is answers
    assert compressor.report()["context"] == len(counts)


def test_an_acknowledgement_ends_the_back_off():
    compressor = RtpCompressor(VOICE, SLOT_NS)
    compressor.handle_peer(heard=True)
    packets = steady_voice(60)
    numbers = []
    for count, packet in packets:
        kind, body, _ = compressor.compress(packet, count)
        if kind == KIND_CONTEXT:
            numbers.append((count, body[0]))
        if count == 1000:
            # The peer has received the newest one.
            compressor.handle_acknowledgement(numbers[-1][1], count)
            acknowledged = numbers[-1][0]
        if 1000 < count < acknowledged + 8000:
            assert kind == KIND_BARE
    # Renewed after 8 s, and not acknowledged again: 3.2 s each from then on.
    later = [count for count, _ in numbers if count > 1000]
    assert later[0] == acknowledged + 8000
    assert {b - a for a, b in pairwise(later)} == {3200}


@pytest.mark.parametrize(("heard", "seconds"), [(True, 8), (False, 1)])
def test_a_context_that_fits_is_renewed_every_eight_seconds_and_one_way_each_second(heard, seconds):
    path = Path(VOICE, heard=heard)
    kinds = [(count, path.send(count, packet)) for count, packet in steady_voice(40)]
    renewed = [count for count, kind in kinds if kind == KIND_CONTEXT]
    assert {b - a for a, b in pairwise(renewed)} == {seconds * 1000}
    assert all(exact for _, _, exact in path.outcomes)


@HEARD
def test_each_packet_and_each_octet_of_its_header_is_counted(heard):
    path = Path(VOICE, heard=heard)
    kinds, octets = [], 0
    for count, packet in voice(Random(1), 5):
        kind, _, header_octets = path.compressor.compress(packet, count)
        kinds.append(kind)
        octets += 1 + header_octets
    report = path.compressor.report()
    assert report.pop("packets") == len(kinds)
    assert report.pop("header_octets") == octets
    assert report["context"] == kinds.count(KIND_CONTEXT)
    assert report["raw"] == kinds.count(KIND_RAW)
    assert report["bare"] == kinds.count(KIND_BARE)
    assert sum(report.values()) == len(kinds)


def test_a_jump_gets_a_context_once_its_absence_has_cost_as_much():
    path = Path(VOICE)
    kinds = {
        count: path.send(count, rtp(count // 20, count * 48 + 5000 * (count >= 4000)))
        for count in blocks(8)
    }
    sent = [count for count, kind in kinds.items() if kind == KIND_CONTEXT]
    assert sent[0] == 0 and len(sent) <= 3 and 4100 < sent[1] < 4500


def video_source(pictures, *, packets=3, step=3000, first=(65_500, (1 << 32) - 8000), waits=()):
    """A source after so many pictures, each sent ten slots after its timestamp."""
    sequence, timestamp = first
    source = None
    for picture in range(pictures):
        for packet in range(packets):
            number = (sequence + picture * packets + packet) % 65536
            at = (timestamp + picture * step) % (1 << 32)
            count = 1000 + picture * step // 90 + (waits[picture] if waits else 0)
            if source is None:
                source = RtpSource(video_flow("video"), FORMS, number, at)
            source.handle_packet(number, at, count)
    return source


@pytest.mark.parametrize(("step", "packets"), [(3000, 3), (1500, 1), (3600, 5)])
def test_a_context_has_what_its_source_does(step, packets):
    source = video_source(150, packets=packets, step=step)
    found = source.context(9, 4321, 1, 96, 0xABCD)
    assert (found.number, found.count, found.marker, found.payload_type, found.ssrc) == (
        *(9, 4321, 1, 96, 0xABCD),
    )
    assert (found.period, found.rate) == (step * 64, packets * 16)
    assert (found.phase, found.lead, found.index) == (0, 0, 149 % 4)
    assert found.sequence == (65_500 + 150 * packets - 1) % 65536
    assert found.timestamp == ((1 << 32) - 8000 + 149 * step) % (1 << 32)
    # It says where the next packets are: all of the next pictures come back from the context.
    for ahead in (1, 2, 50):
        kind_and_residue = FORMS.packers[SHORT](
            0,
            (found.sequence + ahead * packets) % 65536,
            (found.timestamp + ahead * step) % (1 << 32),
            found.index + ahead,
        )
        count = 4321 + round(ahead * step / 90)
        fields = FORMS.unpack(*kind_and_residue, found, count)
        assert fields[1:] == (
            (found.sequence + ahead * packets) % 65536,
            (found.timestamp + ahead * step) % (1 << 32),
        )


def test_an_exact_source_is_known_after_four_steps_and_any_other_after_many():
    assert [video_source(n).known for n in (1, 4, 5)] == [False, False, True]
    uneven = RtpSource(video_flow("video"), FORMS, 0, 0)
    known = []
    for picture in range(1, 40):
        uneven.handle_packet(picture, picture * 3000 + 40 * (-1) ** picture, picture * 33)
        known.append(uneven.known)
    assert known.index(True) == 31
    # A flow with a stride is known at once.
    assert RtpSource(voice_flow("voice"), RtpForms(voice_flow("voice"), SLOT_NS), 0, 0).known


def test_a_longer_wait_than_usual_is_the_lead_of_a_context():
    waits = [10] * 40
    for wait, lead in ((10, 0), (14, 2), (6, -2), (72, 31), (500, 31)):
        source = video_source(40, packets=1, waits=[*waits[:-1], wait])
        assert source.context(1, 1000, 0, 96, 1).lead == lead, wait


def test_blocks_of_another_length_are_followed_after_four_of_them():
    flow = voice_flow("voice")
    forms = RtpForms(flow, SLOT_NS)
    source = RtpSource(flow, forms, 0, 0)
    periods, timestamp = [], 0
    for number, step in enumerate([960] * 3 + [480] * 5 + [5760] * 4 + [6001] * 5):
        timestamp += step
        source.handle_packet(number + 1, timestamp, timestamp // 48)
        periods.append(source.context(1, 0, 0, 97, 1).period // 64)
    # A block of sound is at most 120 ms long (RFC 6716): 5760 ticks.
    assert periods == [960] * 6 + [480] * 5 + [5760] * 6


#: One behaviour of a source: its number of packets, and for each packet: slots since the last one,
#: step of the sequence number, distance of the timestamp from the link's time, marker.
habits = st.fixed_dictionaries(
    {
        "packets": st.integers(1, 60),
        "slots": st.sampled_from([0, 1, 11, 20, 33, 33, 40, 66, 500, 3000]),
        "more_slots": st.integers(0, 30),
        "sequence": st.sampled_from([1, 1, 1, 1, 2, 5, 20, 300, -1, 0, 40_000]),
        "off_ticks": st.sampled_from([0, 0, 1, 60, 180, 1500, 6000]),
        "grid": st.sampled_from([1, 960, 3000, 3000, 3600, 3753, 1500]),
        "ppm": st.sampled_from([0, 0, 200, -200]),
        "marker_each": st.sampled_from([1, 1, 2, 3, 1000]),
        "jump_ticks": st.sampled_from([0, 0, 0, 0, 960, 90_000, 1 << 31, -5]),
        "new_source": st.sampled_from([False, False, False, True]),
        "payload_type": st.sampled_from([96, 96, 96, 97]),
        "gap_slots": st.sampled_from([0, 0, 0, 100, 10_000, 12_200, 13_000, 600_000, 901_000]),
        "loss": st.sampled_from([0.0, 0.0, 0.1, 0.7, 1.0]),
        "acknowledgement_loss": st.sampled_from([0.0, 0.3, 1.0]),
        "delay_slots": st.integers(1, 800),
        "event": st.sampled_from(["", "", "", "deaf", "heard", "receiver", "sender"]),
    }
)


class Source:
    """Packets by habits, with numbers and timestamps near their wraps."""

    def __init__(self, seed):
        self.random = Random(seed)
        self.count = self.random.randrange(1 << 25)
        self.drift = 0.0
        self.begin()

    def begin(self):
        random = self.random
        self.sequence = random.choice([0, 65_500, random.randrange(1 << 16)])
        self.offset = random.choice([0, (1 << 32) - 50_000, random.randrange(1 << 32)])
        self.ssrc = random.randrange(1 << 32)
        self.packets = 0

    def packet(self, habit, ticks_a_slot):
        slots = habit["slots"] + self.random.randrange(habit["more_slots"] + 1)
        self.count += slots
        self.drift += slots * ticks_a_slot * habit["ppm"] * 1e-6
        self.packets += 1
        self.sequence += habit["sequence"]
        line = self.count * ticks_a_slot + round(self.drift)
        line -= line % habit["grid"]
        line += self.random.randint(-habit["off_ticks"], habit["off_ticks"])
        return self.count, rtp(
            self.sequence,
            self.offset + line,
            marker=int(self.packets % habit["marker_each"] == 0),
            payload_type=habit["payload_type"],
            ssrc=self.ssrc,
        )


def run(flow, path, source, habit):
    source.offset += habit["jump_ticks"]
    if habit["new_source"]:
        source.begin()
    for k in range(habit["packets"]):
        count, packet = source.packet(habit, 48 if flow is VOICE else 90)
        path.send(
            count,
            packet,
            arrives=source.random.random() >= habit["loss"],
            told=source.random.random() >= habit["acknowledgement_loss"],
            delay_slots=habit["delay_slots"],
        )
        if k == habit["packets"] // 2:
            source.count += habit["gap_slots"]


@FLOWS
@given(seed=st.integers(0, 1 << 30), history=st.lists(habits, max_size=12), heard=st.booleans())
@settings(max_examples=60)
def test_exact_or_not_at_all(flow, seed, history, heard):
    """Restarts of either end, deafness, any losses: `Path.send` checks all that comes out."""
    source, path = Source(seed), Path(flow, heard=heard)
    for habit in history:
        if habit["event"] == "receiver":
            path.receiver_restarts(source.count, habit["delay_slots"])
        elif habit["event"] == "sender":
            # The receiver notices; acknowledgements to the old life never reach the new one.
            path = Path(flow, heard=path.heard)
        elif habit["event"]:
            path.hear(habit["event"] == "heard")
        run(flow, path, source, habit)


@FLOWS
@given(seed=st.integers(0, 1 << 30), history=st.lists(habits, max_size=12))
@settings(max_examples=60)
def test_two_way_every_received_packet_is_decompressed(flow, seed, history):
    """While the peer is heard and does not restart, no loss makes a later packet unreadable."""
    source, path = Source(seed), Path(flow)
    for habit in history:
        run(flow, path, source, habit)
    assert all(exact for _, _, exact in path.outcomes)

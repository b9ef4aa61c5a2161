"""Which context is used when: two-way, one-way, after gaps, restarts and source changes."""

from itertools import islice, pairwise
from random import Random

import pytest
from link_header_sources import SLOT_NS, Path, b_pictures, rtp, video, voice

from telepresence.link.compression.header_compression import (
    FIRST_WHOLE,
    FLEETING_LIFE_NS,
    LIFE_NS,
    MOST_POSSIBLE,
    RtpCompressor,
    RtpDecompressor,
)
from telepresence.link.compression.rtp_forms import KIND_BARE, KIND_CONTEXT, KIND_RAW
from telepresence.link.flows import video_flow, voice_flow

VIDEO, VOICE = video_flow("video"), voice_flow("voice")
FLEETING_SLOTS, LIFE_SLOTS = FLEETING_LIFE_NS // SLOT_NS, LIFE_NS // SLOT_NS

DOWN = {"packets": (3,), "wait_ms": (8, 12)}
CROWDED_DOWN = {"packets": (2, 3, 3, 3, 4), "wait_ms": (8, 12)}
#: Largest mean cost of each source in octets a packet, with tag, contexts and first packets.
SOURCES = {
    "down, on its grid": (VIDEO, 2.0, lambda r: video(r, 60, **DOWN)),
    "down, 2 to 4 packets": (VIDEO, 2.2, lambda r: video(r, 60, **CROWDED_DOWN)),
    "down, jitter 1 ms": (VIDEO, 2.9, lambda r: video(r, 60, jitter_ms=1, **DOWN)),
    "up, on its grid": (VIDEO, 1.6, lambda r: video(r, 60)),
    "up, 25 Hz": (VIDEO, 1.6, lambda r: video(r, 60, hz=25)),
    "up, 23.976 Hz": (VIDEO, 2.2, lambda r: video(r, 60, hz=24_000 / 1001)),
    "up, jitter 0.05 ms": (VIDEO, 2.2, lambda r: video(r, 60, jitter_ms=0.05)),
    "up, jitter 1 ms": (VIDEO, 2.2, lambda r: video(r, 60, jitter_ms=1)),
    "up, jitter 2 ms": (VIDEO, 2.5, lambda r: video(r, 60, jitter_ms=2)),
    "up, its clock 200 ppm off": (VIDEO, 2.0, lambda r: video(r, 60, ppm=200)),
    "up, pictures left out": (VIDEO, 2.0, lambda r: video(r, 60, skip=0.02)),
    "up, on no grid": (VIDEO, 3.4, lambda r: video(r, 60, jitter_ms=16)),
    "voice": (VOICE, 1.1, lambda r: voice(r, 60)),
    "voice, its clock 200 ppm off": (VOICE, 1.2, lambda r: voice(r, 60, ppm=-200)),
    "voice, blocks of 10 ms": (VOICE, 1.2, lambda r: voice(r, 60, block_ms=10)),
    "voice, blocks of 60 ms": (VOICE, 1.4, lambda r: voice(r, 60, block_ms=60)),
    "up, 3 B pictures": (VIDEO, 4.0, lambda r: b_pictures(r, 60)),
    "down, 3 B pictures": (VIDEO, 4.0, lambda r: b_pictures(r, 60, packets=(2, 3, 4))),
    "down, 1 B picture": (VIDEO, 4.0, lambda r: b_pictures(r, 60, between=1, **DOWN)),
    "down, 60 Hz, 8 packets": (VIDEO, 4.0, lambda r: b_pictures(r, 60, hz=60, packets=(8,))),
}


@pytest.mark.parametrize(("flow", "most", "source"), SOURCES.values(), ids=SOURCES)
def test_headers_cost_two_octets_on_average(flow, most, source):
    path = Path(flow)
    for count, packet in source(Random(1)):
        path.send(count, packet)
    assert all(exact for _, _, exact in path.outcomes)
    print(f"{path.octets_a_packet():.2f}", path.compressor.report())
    assert path.octets_a_packet() <= most


def test_the_streams_of_a_setup_cost_less_than_two_octets_together():
    octets = packets = 0
    for flow, source in (
        (VIDEO, video(Random(1), 60)),
        (VIDEO, video(Random(2), 60, **CROWDED_DOWN)),
        (VOICE, voice(Random(3), 60)),
        (VOICE, voice(Random(4), 60)),
    ):
        path = Path(flow)
        for count, packet in source:
            path.send(count, packet)
        report = path.compressor.report()
        octets += report["header_octets"]
        packets += report["packets"]
    assert octets < 2 * packets


def test_one_way_a_context_a_second_works_without_acknowledgements():
    for flow, source, most in (
        (VIDEO, video(Random(1), 60), 2.2),
        (VOICE, voice(Random(1), 60), 1.5),
    ):
        path = Path(flow, heard=False)
        kinds = [path.send(*item) for item in source]
        assert all(exact for _, _, exact in path.outcomes)
        assert kinds.count(KIND_CONTEXT) <= 61
        assert path.octets_a_packet() <= most


def test_two_way_whole_headers_until_a_context_is_acknowledged():
    path = Path(VOICE)
    kinds = [path.send(count, packet, delay_slots=800) for count, packet in voice(Random(1), 3)]
    assert KIND_BARE not in kinds[:40]
    assert kinds[50:] == [KIND_BARE] * 100


def test_one_way_a_few_whole_headers_come_first():
    path = Path(VOICE, heard=False)
    kinds = [path.send(*item) for item in islice(voice(Random(1), 1, jitter_ms=0), 6)]
    whole = [KIND_CONTEXT] + [KIND_RAW] * (FIRST_WHOLE - 1)
    assert kinds == whole + [KIND_BARE] * 3


@pytest.mark.parametrize("gap_s", [0.1, 1, 10, 600])
@pytest.mark.parametrize("flow", [VIDEO, VOICE], ids=["video", "voice"])
@pytest.mark.parametrize("deaf", [False, True], ids=["hearing", "deaf"])
def test_first_packet_after_any_gap_is_exact(flow, gap_s, deaf):
    """Two-way before; during the gap nothing arrives in one direction, or in both."""
    path = Path(flow)
    start, end = 5000, 5000 + round(gap_s * 1000)
    seconds = gap_s + 15
    source = video(Random(2), seconds, jitter_ms=1) if flow is VIDEO else voice(Random(2), seconds)
    for count, packet in source:
        lost = start <= count < end
        # The peer is heard again only after the packets that were sent first have arrived.
        path.hear(not (deaf and start <= count < end + 300))
        path.send(count, packet, arrives=not lost, told=not lost)
    assert any(count >= end for count, _, _ in path.outcomes)
    assert all(exact for _, _, exact in path.outcomes)


def test_one_way_the_first_packet_after_ten_seconds_is_exact():
    for flow, source in ((VIDEO, video(Random(3), 30)), (VOICE, voice(Random(3), 30))):
        path = Path(flow, heard=False)
        for count, packet in source:
            path.send(count, packet, arrives=not 5000 <= count < 15_000)
        assert all(exact for _, _, exact in path.outcomes)


def test_one_way_a_longer_gap_ends_with_the_next_context():
    path = Path(VOICE, heard=False)
    for count, packet in voice(Random(3), 60):
        path.send(count, packet, arrives=not 5000 <= count < 35_000)
    dropped = [count for count, _, exact in path.outcomes if not exact]
    assert dropped
    assert max(dropped) < 35_000 + 1000 + 20


def test_a_restarted_source_sends_whole_headers_until_its_context_is_held():
    path = Path(VIDEO)
    for count, packet in video(Random(1), 5):
        path.send(count, packet)
    later = count
    kinds = [path.send(later + count, packet) for count, packet in video(Random(2), 5)]
    assert kinds[0] in (KIND_RAW, KIND_CONTEXT)
    assert KIND_CONTEXT in kinds[:5]
    assert all(kind >= KIND_BARE for kind in kinds[10:20])
    assert all(exact for _, _, exact in path.outcomes)


def test_a_restarted_peer_gets_whole_headers_once_the_restart_is_known():
    path = Path(VOICE)
    for number, (count, packet) in enumerate(voice(Random(1), 10)):
        if number == 200:  # at about 5000
            path.receiver_restarts(count, 300)
        path.send(count, packet)
    dropped = [count for count, _, exact in path.outcomes if not exact]
    assert dropped
    assert max(dropped) < 5000 + 300 + 60
    assert path.outcomes[-1][1] == KIND_BARE


def test_whole_headers_again_as_soon_as_the_peers_new_life_is_known():
    path = Path(VOICE)
    source = voice(Random(1), 2)
    kinds = [path.send(*next(source)) for _ in range(30)]
    assert kinds[-1] == KIND_BARE
    path.compressor.forget()
    assert path.send(*next(source)) in (KIND_RAW, KIND_CONTEXT)


def test_unacknowledged_contexts_are_sent_at_a_limited_rate():
    """A peer that is heard but holds nothing: the sender retries at growing intervals."""
    compressor = RtpCompressor(VOICE, SLOT_NS)
    compressor.handle_peer(heard=True)
    counts = []
    for count, packet in voice(Random(1), 120):
        compressor.handle_acknowledgement(0, count)
        if compressor.compress(packet, count)[0] == KIND_CONTEXT:
            counts.append(count)
    distances = [later - earlier for earlier, later in pairwise(counts)]
    assert min(distances) >= 100
    assert counts[-1] > 110_000
    assert len(counts) < 60


def test_a_peer_that_acknowledges_nothing_gets_a_limited_number_of_contexts():
    compressor = RtpCompressor(VOICE, SLOT_NS)
    compressor.handle_peer(heard=True)
    kinds = [compressor.compress(packet, count)[0] for count, packet in voice(Random(1), 120)]
    assert kinds.count(KIND_CONTEXT) == MOST_POSSIBLE


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


def plain(timestamp, *, hz=30, seconds=60, ssrc=7, first_octet=0x80):
    """Return (count, packet) of `hz` packets a second, each a millisecond after its instant."""
    random = Random(1)
    for number in range(hz * seconds):
        packet = rtp(number, timestamp(number, random), ssrc=ssrc)
        yield 1000 + number * 1000 // hz, bytes([first_octet]) + packet[1:]


def alternating(hz, seconds=60):
    """Two sources of one flow, packet by packet."""
    one = plain(lambda number, _: number * 3000, hz=hz // 2, seconds=seconds)
    other = plain(lambda number, _: 77_777 + number * 3000, hz=hz // 2, seconds=seconds, ssrc=8)
    for first, second in zip(one, other, strict=True):
        yield first
        yield first[0] + 500 // hz, second[1]


def some_plain():
    """Random timestamps, and nine packets of ten with an extension."""
    for number, (count, packet) in enumerate(plain(lambda _, random: random.randrange(1 << 32))):
        yield count, b"\x90" + packet[1:] if number % 10 else packet


NEVER_GAINING = {
    "constant timestamps": (VIDEO, lambda: plain(lambda *_: 12_345)),
    "random timestamps": (VIDEO, lambda: plain(lambda _, random: random.randrange(1 << 32))),
    "random timestamps, voice": (
        VOICE,
        lambda: plain(lambda _, random: random.randrange(1 << 32), hz=50),
    ),
    "two SSRCs": (VOICE, lambda: alternating(50)),
    "extensions": (VIDEO, some_plain),
    "8 kHz in a voice flow": (VOICE, lambda: plain(lambda number, _: number * 160, hz=50)),
    "8 kHz in a video flow": (VIDEO, lambda: plain(lambda number, _: number * 160, hz=50)),
}


@pytest.mark.parametrize(("heard", "delay_slots"), [(True, 40), (True, 800), (False, 0)])
@pytest.mark.parametrize(("flow", "source"), NEVER_GAINING.values(), ids=NEVER_GAINING)
def test_a_source_that_never_gains_costs_its_raw_headers(flow, source, heard, delay_slots):
    path = Path(flow, heard=heard)
    for count, packet in source():
        path.send(count, packet, delay_slots=delay_slots)
    assert path.octets_a_packet() <= 13.05
    assert all(exact for _, _, exact in path.outcomes)


@pytest.mark.parametrize("heard", [True, False])
def test_a_source_that_becomes_regular_gets_contexts_again(heard):
    path = Path(VIDEO, heard=heard)
    for count, packet in plain(lambda _, random: random.randrange(1 << 32)):
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


@pytest.mark.parametrize(("heard", "life"), [(True, LIFE_SLOTS), (False, FLEETING_SLOTS)])
def test_a_context_expires_at_the_receiver(heard, life):
    compressor, decompressor = RtpCompressor(VOICE, SLOT_NS), RtpDecompressor(VOICE, SLOT_NS)
    compressor.handle_peer(heard=heard)
    kind, body, _ = compressor.compress(rtp(0, 0), 0)
    assert kind == KIND_CONTEXT
    decompressor.decompress(kind, body, 0)
    assert decompressor.context_id == int(heard)
    assert isinstance(decompressor.decompress(KIND_BARE, b"", life), bytes)
    assert decompressor.decompress(KIND_BARE, b"", life + 1) == "no_context"


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


def test_a_slow_start_costs_no_additional_headers():
    """In a live session, processes start while the first pictures wait.

    Of ten pictures in the first third of a second two are encoded, the first 200 ms late. As much
    time passes again until no picture waits.
    """
    waits_ms = {0: 205, 6: 115, 10: 60, 11: 54, 12: 46, 13: 46, 14: 37, 15: 28, 16: 33, 17: 25}
    path = Path(VIDEO)
    sent = [(1000 + round(n * 100 / 3) + waits_ms.get(n, 0), n) for n in (0, 6, *range(10, 300))]
    kinds = [
        path.send(count, rtp(number, n * 3000, marker=1)) for number, (count, n) in enumerate(sent)
    ]
    assert all(exact for _, _, exact in path.outcomes)
    assert sum(kind in (KIND_RAW, KIND_CONTEXT) for kind in kinds) <= 15

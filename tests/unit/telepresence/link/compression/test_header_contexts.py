"""When a new header context is sent: the one-way rule, the back-off and the renewal."""

from itertools import pairwise
from random import Random

import pytest
from link_header_sources import SLOT_NS, Path, rtp, video, voice

from telepresence.link.compression.header_compression import MOST_POSSIBLE, RtpCompressor
from telepresence.link.compression.rtp_forms import KIND_BARE, KIND_CONTEXT, KIND_RAW
from telepresence.link.flows import video_flow, voice_flow

VIDEO, VOICE = video_flow("video"), voice_flow("voice")


def steady_voice(seconds):
    return [(count, rtp(count // 20, count * 48, payload_type=97)) for count in blocks(seconds)]


def blocks(seconds):
    return range(0, seconds * 1000, 20)


def contexts_of(compressor, packets):
    """Return the frame counts at which contexts are sent."""
    return [
        count for count, packet in packets if compressor.compress(packet, count)[0] == KIND_CONTEXT
    ]


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


def test_contexts_that_are_not_acknowledged_follow_after_twice_the_time_each():
    compressor = RtpCompressor(VOICE, SLOT_NS)
    compressor.handle_peer(heard=True)
    counts = contexts_of(compressor, steady_voice(120))
    distances = [later - earlier for earlier, later in pairwise(counts)]
    assert distances == [100, 200, 400, 800, 1600] + [3200] * (MOST_POSSIBLE - 6)
    assert compressor.report()["context"] == MOST_POSSIBLE


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


def test_a_context_that_fits_is_renewed_every_eight_seconds():
    path = Path(VOICE)
    kinds = [(count, path.send(count, packet)) for count, packet in steady_voice(60)]
    renewed = [count for count, kind in kinds if kind == KIND_CONTEXT]
    assert {b - a for a, b in pairwise(renewed)} == {8000}
    assert all(exact for _, _, exact in path.outcomes)


def test_one_way_contexts_follow_each_second():
    path = Path(VOICE, heard=False)
    kinds = [(count, path.send(count, packet)) for count, packet in steady_voice(30)]
    sent = [count for count, kind in kinds if kind == KIND_CONTEXT]
    assert {b - a for a, b in pairwise(sent)} == {1000}


@pytest.mark.parametrize("heard", [True, False])
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

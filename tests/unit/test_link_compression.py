"""RTP headers come out bit for bit, from any context that the receiver may hold."""

import struct

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from telepresence.link.compression import (
    CONTEXT_LIFE_SLOTS,
    REFRESH_SLOTS,
    RtpCompressor,
    RtpDecompressor,
)
from telepresence.link.flows import video_flow, voice_flow
from telepresence.link.frame import TYPE_COMPRESSED, TYPE_CONTEXT, TYPE_RAW

MS = 1_000_000
VIDEO, VOICE = video_flow("video"), voice_flow("voice")


def rtp(sequence, timestamp, *, marker=0, payload_type=96, ssrc=7, payload=b"payload"):
    header = struct.pack(
        ">BBHII", 0x80, marker << 7 | payload_type, sequence & 0xFFFF, timestamp & 0xFFFFFFFF, ssrc
    )
    return header + payload


def pair(flow):
    return RtpCompressor(flow, MS), RtpDecompressor(flow, MS)


def test_video_over_both_wraps_costs_three_octets():
    compressor, decompressor = pair(VIDEO)
    sizes = []
    for k in range(300):
        jitter = (k * 7919) % 60 * 90  # up to 60 ms between capture and the radio
        packet = rtp(65_400 + k, 2**32 - 50_000 + k * 3000 + jitter, marker=k % 2)
        tag_type, body, header_octets = compressor.compress(packet, k * 33)
        sizes.append(header_octets)
        assert decompressor.decompress(tag_type, body, k * 33) == packet
    assert set(sizes) == {3, 12}
    assert sizes.count(12) == 300 * 33 // REFRESH_SLOTS + 1


def test_voice_over_both_wraps_costs_one_octet():
    compressor, decompressor = pair(VOICE)
    sizes = []
    for k in range(500):
        packet = rtp(65_400 + k, 2**32 - 50_000 + k * 960, marker=k == 0)
        tag_type, body, header_octets = compressor.compress(packet, k * 20 + k % 3)
        sizes.append(header_octets)
        assert decompressor.decompress(tag_type, body, k * 20 + k % 3) == packet
    assert set(sizes) == {1, 12}
    assert sizes.count(12) <= 500 * 20 // REFRESH_SLOTS + 1


@pytest.mark.parametrize(
    ("flow", "period", "step"), [(VIDEO, 33, 2970), (VOICE, 20, 960)], ids=["video", "voice"]
)
@pytest.mark.parametrize("gap_slots", [100, 1500, 5000, 10_000])
def test_first_packet_after_a_gap_is_exact(flow, period, step, gap_slots):
    compressor, decompressor = pair(flow)
    received = []
    for k in range(20_000 // period):
        packet = rtp(k, k * step)
        tag_type, body, _ = compressor.compress(packet, k * period)
        if not 2000 <= k * period < 2000 + gap_slots:
            received.append((decompressor.decompress(tag_type, body, k * period), packet))
    assert all(out == packet for out, packet in received)


def test_restarted_sender_takes_a_new_context_at_once():
    compressor, decompressor = pair(VIDEO)
    count = 0
    for life in range(3):
        for k in range(20):
            packet = rtp(1000 * life + k, 77_777 * life + k * 3000, ssrc=life)
            tag_type, body, _ = compressor.compress(packet, count)
            assert tag_type == TYPE_CONTEXT if k == 0 else tag_type >= TYPE_COMPRESSED
            assert decompressor.decompress(tag_type, body, count) == packet
            count += 33


def test_generations_are_not_reused_while_a_receiver_may_hold_them():
    compressor, decompressor = pair(VIDEO)
    types = []
    for life in range(6):
        packet = rtp(0, 0, ssrc=life)
        tag_type, body, _ = compressor.compress(packet, life)
        types.append(tag_type)
        assert decompressor.decompress(tag_type, body, life) == packet
    assert types == [TYPE_CONTEXT] * 4 + [TYPE_RAW] * 2
    tag_type, _, _ = compressor.compress(rtp(0, 0, ssrc=9), CONTEXT_LIFE_SLOTS + 4)
    assert tag_type == TYPE_CONTEXT


def test_a_slow_drift_stays_exact_for_a_receiver_that_missed_the_refreshes():
    """Each context is near the one before, but the third packet is too far from the first."""
    compressor, decompressor = pair(VIDEO)
    drift = 80 * 90
    for k in range(4):
        count = k * REFRESH_SLOTS
        packet = rtp(k, count * 90 + k * drift)
        tag_type, body, _ = compressor.compress(packet, count)
        assert tag_type == TYPE_CONTEXT
        if k == 0:
            assert decompressor.decompress(tag_type, body, count) == packet
    packet = rtp(4, (count + 1) * 90 + 3 * drift)
    tag_type, body, _ = compressor.compress(packet, count + 1)
    assert tag_type >= TYPE_COMPRESSED
    assert decompressor.decompress(tag_type, body, count + 1) == "no_context"


@pytest.mark.parametrize(
    "first_octets",
    [b"\x81\x60", b"\x90\x60", b"\xa0\x60", b"\x60\x60"],
    ids=["csrc", "extension", "padding", "version"],
)
def test_other_headers_go_as_they_are(first_octets):
    compressor, decompressor = pair(VIDEO)
    packet = first_octets + bytes(30)
    tag_type, body, _ = compressor.compress(packet, 0)
    assert (tag_type, body) == (TYPE_RAW, packet)
    assert decompressor.decompress(tag_type, body, 0) == packet


def test_without_a_context_nothing_comes_out():
    compressor, decompressor = pair(VIDEO)
    compressor.compress(rtp(0, 0), 0)
    tag_type, body, _ = compressor.compress(rtp(1, 3000), 33)
    assert decompressor.decompress(tag_type, body, 33) == "no_context"
    assert decompressor.decompress(tag_type, b"", 33) == "no_context"


steps = st.lists(
    st.tuples(
        st.sampled_from(
            [0, 1, 20, 33, 33, 500, 1000, 3000, 12_200, 12_201]
        ),  # slots since the last
        st.sampled_from([1, 1, 1, 1, 2, 200, 511, 512, 40_000, -1, 0]),  # sequence step
        st.sampled_from(
            [0, 0, 0, 960, 4000, 7000, 8191, 8192, -8192, 100_000, 1 << 31]
        ),  # off the line
        st.booleans(),  # marker
        st.sampled_from([0, 0, 0, 0, 1]),  # a new SSRC
        st.booleans(),  # received
    ),
    max_size=60,
)


@pytest.mark.parametrize("flow", [VIDEO, VOICE], ids=["video", "voice"])
@given(steps)
@settings(max_examples=300, deadline=None)
def test_exact_or_not_at_all(flow, steps):
    """Whatever the sender does and whichever packets get lost, no header comes out wrong."""
    compressor, decompressor = pair(flow)
    count, sequence, timestamp, ssrc = 0, 65_000, 2**32 - 5000, 1
    for slots, step, off, marker, new_ssrc, is_received in steps:
        count += slots
        sequence += step
        line = step * 960 if flow is VOICE else slots * 90
        timestamp += line + off
        ssrc += new_ssrc
        packet = rtp(sequence, timestamp, marker=marker, ssrc=ssrc)
        tag_type, body, _ = compressor.compress(packet, count)
        if is_received:
            out = decompressor.decompress(tag_type, body, count)
            assert out in (packet, "no_context")

"""Capacity arithmetic: which caps fit, and that no real run needs more than computed."""

import struct

import pytest

from kontur_av.errors import ConfigError
from telepresence.link.arithmetic import (
    MOST_COMPRESSED_PER_S,
    StreamNeed,
    channel_need,
    channel_table,
    check_fit,
    largest_payload_bps,
)
from telepresence.link.flows import Level, video_flow, voice_flow
from telepresence.link.profile import DOWNLINK, UPLINK
from telepresence.link.sender import LinkSender


def video(kbps, packets_per_s=30):
    return StreamNeed(name="uplink_video", payload_bps=kbps * 1000, packets_per_s=packets_per_s)


VOICE = StreamNeed(name="uplink_voice", payload_bps=8000, packets_per_s=50, level=Level.VOICE)


def test_the_setups_fit():
    # 93 000 payload; 30*4 + 50*2 octets of headers and resume tags; a whole header each 1.6 s;
    # 600 of reserve for TM/TC and RTCP; five supervision messages of 12 octets in two seconds.
    need = check_fit(UPLINK, [video(85), VOICE])
    assert need.needed_bps == 93_000 + (30 * 4 + 50 * 2) * 8 + 45 + 60 + 600 + 5 * 12 * 4
    assert need.spare_bps == 96_000 - need.needed_bps == 295
    assert channel_need(UPLINK, [video(85, packets_per_s=35), VOICE]).fits
    assert channel_need(UPLINK, [video(90, packets_per_s=35)]).fits


def test_too_high_a_cap_is_refused_with_the_highest_that_fits():
    with pytest.raises(ConfigError, match=r"uplink_video at 95 kbit/s .* at most 94 kbit/s$"):
        check_fit(UPLINK, [video(95)])
    with pytest.raises(ConfigError, match="at most 85 kbit/s"):
        check_fit(UPLINK, [video(90), VOICE])
    fits_bps = largest_payload_bps(UPLINK, [video(95)], "uplink_video")
    assert channel_need(UPLINK, [video(94)]).fits
    exact = StreamNeed(name="v", payload_bps=fits_bps, packets_per_s=30)
    assert channel_need(UPLINK, [exact]).spare_bps == 0


@pytest.mark.parametrize(
    ("profile", "streams"),
    [
        (UPLINK, [video(85), VOICE]),
        (UPLINK, [video(95), VOICE]),
        (DOWNLINK, [video(512, 90), VOICE]),
        (UPLINK, []),
    ],
    ids=["fits", "too much", "down", "nothing"],
)
def test_the_table_adds_up_to_the_channel(profile, streams):
    table = channel_table(profile, streams)
    need = channel_need(profile, streams)
    assert sum(line.bps for line in table) == profile.media_bps
    assert table[-1] == ("spare", "", need.spare_bps)
    by_what = {what: sum(line.bps for line in table if line.what == what) for what, _, _ in table}
    overhead = ("headers", "contexts", "framing")
    assert sum(by_what.get(what, 0) for what in overhead) == need.overhead_bps
    assert by_what["tmtc"] + by_what["rtcp"] == need.reserve_bps
    assert by_what["supervision"] == need.supervision_bps


def overhead_bps_of_a_run(profile, video_bps, packets_per_s, voice_bps, seconds=30):
    """Return the bit rate of headers and framing in a real run of a sender at these rates."""
    sender = LinkSender(profile, [video_flow("video"), voice_flow("voice")])
    video_octets, sent = video_bps // 8 // packets_per_s, 0
    for slot in range(seconds * 1000):
        now_ns = slot * 1_000_000
        while sent * 1000 < slot * packets_per_s:
            header = struct.pack(">BBHII", 0x80, 96, sent & 0xFFFF, slot * 90, 1)
            sender.handle_packet("video", header + bytes(video_octets), now_ns)
            sent += 1
        if slot % 20 == 7 and voice_bps:
            header = struct.pack(">BBHII", 0x80, 97, slot // 20, slot // 20 * 960, 2)
            sender.handle_packet("voice", header + bytes(voice_bps // 400), now_ns)
        sender.handle_haptic(bytes(12), now_ns)
        sender.poll_transmit(now_ns)
    octets = sender.octets()
    mpdu = (profile.data_octets - profile.packet_zone_octets) * sender.frames_sent
    assert not any(sender.report(now_ns).queue["video"].drops.values())
    return (octets["packet_headers"] + octets["framing"] - mpdu) * 8 / seconds


@pytest.mark.parametrize(
    ("profile", "video_kbps", "packets_per_s", "voice_kbps"),
    [
        (UPLINK, 85, 30, 8),
        (UPLINK, 85, 35, 8),
        (DOWNLINK, 512, 90, 64),
        (DOWNLINK, 100, 30, 8),
        (DOWNLINK, 1600, 200, 64),
        (DOWNLINK, 3000, 375, 64),
    ],
)
def test_no_run_needs_more_than_computed(profile, video_kbps, packets_per_s, voice_kbps):
    streams = [video(video_kbps, packets_per_s)]
    if voice_kbps:
        voice = {"name": "voice", "payload_bps": voice_kbps * 1000, "packets_per_s": 50}
        streams.append(StreamNeed(**voice, level=Level.VOICE))
    reckoned_bps = channel_need(profile, streams).overhead_bps
    rates = (video_kbps * 1000, packets_per_s, voice_kbps * 1000)
    measured_bps = overhead_bps_of_a_run(profile, *rates)
    # Up to three more whole headers of each stream, at the start of the 30 s.
    assert measured_bps <= reckoned_bps + 3 * (9 + 12) * 8 / 30
    # Above that rate the arithmetic assumes a source with many packets a picture.
    assert measured_bps > 0.5 * reckoned_bps or packets_per_s > MOST_COMPRESSED_PER_S

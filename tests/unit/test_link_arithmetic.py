"""Rates of the profiles, and which caps fit."""

import pytest

from kontur_av.errors import ConfigError
from telepresence.link.arithmetic import (
    StreamNeed,
    channel_need,
    check_fit,
    largest_payload_bps,
)
from telepresence.link.flows import Flow, FlowKind, Level, check_flows, video_flow
from telepresence.link.profile import DOWNLINK, UPLINK, LinkProfile


def video(kbps, packets_per_s=30):
    return StreamNeed(name="uplink_video", payload_bps=kbps * 1000, packets_per_s=packets_per_s)


VOICE = StreamNeed(name="uplink_voice", payload_bps=8000, packets_per_s=50, level=Level.VOICE)


def test_rates_of_the_profiles():
    assert UPLINK.capacity_bps == 256_000
    assert UPLINK.application_bps == 192_000
    assert UPLINK.media_bps == 96_000
    assert DOWNLINK.capacity_bps == 4_000_000
    assert DOWNLINK.data_octets == 480
    assert DOWNLINK.media_bps == 478 * 8 * 1000


def test_the_setups_fit():
    # 93 000 payload; 30*4 + 50*3 octets of headers and a context a second each; 400 in reserve.
    need = check_fit(UPLINK, [video(85), VOICE])
    assert need.needed_bps == 93_000 + (30 * 4 + 50 * 3 + 9 + 11) * 8 + 400
    assert need.spare_bps == 96_000 - need.needed_bps >= 0
    assert channel_need(UPLINK, [video(85, packets_per_s=35), VOICE]).fits
    assert channel_need(UPLINK, [video(90, packets_per_s=35)]).fits


def test_a_cap_too_high_is_refused_with_the_one_that_fits():
    with pytest.raises(ConfigError, match=r"uplink_video at 95 kbit/s .* at most 94 kbit/s$"):
        check_fit(UPLINK, [video(95)])
    with pytest.raises(ConfigError, match="at most 85 kbit/s"):
        check_fit(UPLINK, [video(90), VOICE])
    fits_bps = largest_payload_bps(UPLINK, [video(95)], "uplink_video")
    assert channel_need(UPLINK, [video(94)]).fits
    exact = StreamNeed(name="v", payload_bps=fits_bps, packets_per_s=30)
    assert channel_need(UPLINK, [exact]).spare_bps == 0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"frame_octets": 20}, "at least 26"),
        ({"frame_octets": 40, "pointer_in_signaling": True}, "set it to false"),
        ({"frame_octets": 4000}, "at most 2066"),
        ({"frame_octets": 32, "scid": 256}, "scid"),
    ],
)
def test_profiles_that_cannot_be(changes, message):
    with pytest.raises(ConfigError, match=message):
        LinkProfile(**{"name": "odd", "scid": 1, **changes})


def test_flow_tables_that_cannot_be():
    with pytest.raises(ConfigError, match="twice"):
        check_flows([video_flow("a"), video_flow("a")])
    with pytest.raises(ConfigError, match="at most 16"):
        check_flows([video_flow(str(k)) for k in range(17)])
    with pytest.raises(ConfigError, match="clock_hz"):
        Flow(name="rtp", level=Level.VIDEO, kind=FlowKind.RTP)

"""What profiles and flow tables refuse, and with which words."""

import pytest

from kontur_av.errors import ConfigError
from telepresence.link.flows import Level, check_flows, packet_flow, video_flow
from telepresence.link.profile import DOWNLINK, UPLINK, LinkProfile


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"frame_octets": 31, "pointer_in_vcid": True}, "must be at least 32"),
        ({"frame_octets": 33}, "must be at least 34"),
        ({"frame_octets": 36, "pointer_in_vcid": True}, "at most 27 octets, not 28"),
        ({"frame_octets": 2054}, "must be at most 2053"),
        ({"frame_octets": 2054, "insert_octets": 0}, "must be at most 2053"),
    ],
)
def test_a_profile_with_a_pointer_too_narrow_for_its_zone_is_refused(fields, message):
    with pytest.raises(ConfigError, match=message):
        LinkProfile(name="own", scid=1, **fields)


@pytest.mark.parametrize(
    ("fields", "most"), [({}, 62), ({"frame_octets": 32, "pointer_in_vcid": True}, 31)]
)
def test_a_virtual_channel_never_becomes_that_of_idle_frames(fields, most):
    fields = {"name": "own", "scid": 1, "frame_octets": 40, **fields}
    LinkProfile(vcid=most, **fields)
    with pytest.raises(ConfigError, match=f"must be from 0 to {most}"):
        LinkProfile(vcid=most + 1, **fields)


def test_zones_with_a_sample_and_without():
    assert (UPLINK.packet_zone_octets, UPLINK.largest_zone_octets) == (12, 24)
    assert (DOWNLINK.packet_zone_octets, DOWNLINK.largest_zone_octets) == (478, 490)
    # 24 of 32 and 492 of 500 octets are for applications.
    assert UPLINK.insert_octets + UPLINK.data_octets == 24
    assert DOWNLINK.insert_octets + DOWNLINK.data_octets == 492


def test_a_table_has_eight_flows_four_of_them_rtp():
    raw = [packet_flow(f"raw{k}", Level.TMTC) for k in range(9)]
    rtp = [video_flow(f"rtp{k}") for k in range(5)]
    assert len(check_flows([*raw[:4], *rtp[:4]])) == 8
    with pytest.raises(ConfigError, match="9 flows: a direction carries at most 8"):
        check_flows(raw)
    with pytest.raises(ConfigError, match=r"5 RTP flows .* at most 4; make rtp4 a raw flow"):
        check_flows(rtp)
    with pytest.raises(ConfigError, match="raw0 appears twice"):
        check_flows([raw[0], raw[0]])

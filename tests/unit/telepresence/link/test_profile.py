"""The two links of the mission, and what a profile refuses, in the words of the refusal."""

from dataclasses import replace

import pytest

from kontur_av.errors import ConfigError
from telepresence.link.profile import DOWNLINK, UPLINK

MS = 1_000_000


def test_the_identifiers_zones_and_rates_of_both_links_are_fixed():
    # Recordings and other ends know them.
    assert (UPLINK.frame_octets, UPLINK.scid, UPLINK.vcid) == (32, 75, 0)
    assert (DOWNLINK.frame_octets, DOWNLINK.scid, DOWNLINK.vcid) == (500, 76, 1)
    assert UPLINK.pointer_in_vcid and not DOWNLINK.pointer_in_vcid
    zones = [
        (one.data_octets, one.mpdu_octets, one.packet_zone_octets, one.largest_zone_octets)
        for one in (UPLINK, DOWNLINK)
    ]
    assert zones == [(12, 0, 12, 24), (480, 2, 478, 490)]
    assert (UPLINK.capacity_bps, UPLINK.media_bps) == (256_000, 96_000)
    assert (DOWNLINK.capacity_bps, DOWNLINK.media_bps) == (4_000_000, 3_824_000)
    assert replace(DOWNLINK, slot_ns=3 * MS).capacity_bps == 500 * 8 * 1000 // 3


@pytest.mark.rule("6")
@pytest.mark.parametrize(
    ("profile", "field", "fits", "not_these", "words"),
    [
        (DOWNLINK, "scid", (0, 255), (-1, 256), "from 0 to 255"),
        # Channel 63 is for idle frames (CCSDS 732.0-B-5, 4.1.2.3).
        (DOWNLINK, "vcid", (0, 62), (-1, 63), "from 0 to 62"),
        (UPLINK, "vcid", (0, 31), (-1, 32), "from 0 to 31"),
        (DOWNLINK, "slot_ns", (1, MS), (0, -1), "must be positive"),
        (DOWNLINK, "insert_octets", (0, 12), (-1,), "at least 0"),
        # Header 6, insert zone 12, FECF 2, and 12 octets of a supervision message.
        (UPLINK, "frame_octets", (32, 35), (31,), "at least 32 to carry"),
        (UPLINK, "frame_octets", (32, 35), (36,), "at most 27 octets, not 28: set it to false"),
        # Two more of an M_PDU header. A pointer has 11 bits, five of its values are codes.
        (DOWNLINK, "frame_octets", (34, 2053), (33,), "at least 34 to carry"),
        (DOWNLINK, "frame_octets", (34, 2053), (2054,), "at most 2053"),
    ],
)
def test_a_profile_has_limits(profile, field, fits, not_these, words):
    for value in fits:
        assert getattr(replace(profile, **{field: value}), field) == value
    for value in not_these:
        with pytest.raises(ConfigError, match=f"^{profile.name}.*{words}"):
            replace(profile, **{field: value})


def test_a_profile_without_samples_has_the_same_largest_frame():
    with pytest.raises(ConfigError, match="must be at most 2053"):
        replace(DOWNLINK, frame_octets=2054, insert_octets=0)

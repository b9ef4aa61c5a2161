"""The limits of the link's tables: the last value that fits, and the first one that does not."""

from dataclasses import replace

import pytest

from kontur_av.errors import ConfigError
from telepresence.link.bucket import Allowance
from telepresence.link.flows import (
    Flow,
    FlowKind,
    Level,
    check_flows,
    packet_flow,
    rtcp_flow,
    tmtc_flow,
    video_flow,
    voice_flow,
)
from telepresence.link.gateway import Backlog
from telepresence.link.profile import DOWNLINK, UPLINK

MS = 1_000_000


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


def test_zones_and_rates_of_the_two_directions():
    zones = [
        (one.data_octets, one.mpdu_octets, one.packet_zone_octets, one.largest_zone_octets)
        for one in (UPLINK, DOWNLINK)
    ]
    assert zones == [(12, 0, 12, 24), (480, 2, 478, 490)]
    assert [(one.capacity_bps, one.media_bps) for one in (UPLINK, DOWNLINK)] == [
        (256_000, 96_000),
        (4_000_000, 3_824_000),
    ]
    slow = replace(DOWNLINK, slot_ns=3 * MS)
    assert slow.capacity_bps == 500 * 8 * 1000 // 3


def test_a_flow_has_what_its_kind_needs():
    table = check_flows(
        (
            video_flow("v"),
            voice_flow("a"),
            rtcp_flow("r"),
            tmtc_flow("t"),
            packet_flow("p", Level(3)),
        )
    )
    # RFC 6184: 90 kHz; RFC 7587: 48 kHz, here a packet every 20 ms.
    assert [(flow.level, flow.kind.value, flow.clock_hz, flow.stride_ticks) for flow in table] == [
        (2, "rtp", 90_000, 0),
        (1, "rtp", 48_000, 960),
        (2, "rtcp", 0, 0),
        (0, "tmtc", 0, 0),
        (3, "raw", 0, 0),
    ]
    for clock_hz in (0, -1):
        with pytest.raises(ConfigError, match="flow x: an RTP flow needs clock_hz"):
            Flow(name="x", level=Level.VIDEO, kind=FlowKind.RTP, clock_hz=clock_hz)
    assert Flow(name="x", level=Level.VIDEO, kind=FlowKind.RTP, clock_hz=1).stride_ticks == 0
    with pytest.raises(ConfigError, match="stride_ticks must not be negative"):
        Flow(name="x", level=Level.VIDEO, kind=FlowKind.RAW, stride_ticks=-1)


def test_a_direction_carries_eight_flows_four_of_them_rtp():
    raw = [packet_flow(f"raw{number}", Level.MAINTENANCE) for number in range(9)]
    rtp = [video_flow(f"rtp{number}") for number in range(5)]
    assert len(check_flows(raw[:8])) == 8 and len(check_flows(rtp[:4] + raw[:4])) == 8
    with pytest.raises(ConfigError, match="9 flows: a direction carries at most 8"):
        check_flows(raw)
    with pytest.raises(ConfigError, match=r"5 RTP flows .*at most 4; make rtp4 a raw flow"):
        check_flows(rtp)
    with pytest.raises(ConfigError, match="flow raw1 appears twice"):
        check_flows([*raw[:3], raw[1]])


def test_an_allowance_says_when_it_holds_so_many():
    """Four at once, then one every 10 ms, by a count of tokens beside it."""
    allowance, tokens, now_ms = Allowance(4, 10 * MS), 4.0, 0
    assert allowance.holds_ns(9, 5 * MS) == 5 * MS
    for pause_ms, count in ((0, 1), (3, 3), (12, 1), (0, 2), (55, 4), (1, 4), (200, 4), (7, 9)):
        now_ms += pause_ms
        tokens = min(4.0, tokens + pause_ms / 10)
        # What exceeds the burst needs a full bucket.
        wait_ms = max(0.0, (min(count, 4) - tokens) * 10)
        due_ns = round((now_ms + wait_ms) * MS)
        assert allowance.holds_ns(count, now_ms * MS) == due_ns
        assert allowance.holds(count, now_ms * MS) is (wait_ms == 0.0)
        assert allowance.holds(count, due_ns) and not (
            wait_ms and allowance.holds(count, due_ns - 1)
        )
        now_ms, tokens = due_ns / MS, tokens + wait_ms / 10
        allowance.take(count, due_ns)
        tokens -= count


def test_a_backlog_crosses_processes_as_it_is():
    backlog = Backlog(1 << 40, 3, True, 96_000, 7)
    assert Backlog.unpack(backlog.pack()) == backlog

"""What a flow has by its kind, and which flows fit into one direction."""

import pytest

from kontur_av.errors import ConfigError
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


def test_a_direction_carries_eight_flows():
    raw = [packet_flow(f"raw{number}", Level.MAINTENANCE) for number in range(9)]
    assert len(check_flows(raw[:8])) == 8
    with pytest.raises(ConfigError, match="9 flows: a direction carries at most 8"):
        check_flows(raw)
    with pytest.raises(ConfigError, match="flow raw1 appears twice"):
        check_flows([*raw[:3], raw[1]])

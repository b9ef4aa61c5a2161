"""The two links of the mission, and what waits before them, as docs/link.md states them."""

import pytest

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.errors import ConfigError
from telepresence.link.flows import Level
from telepresence.link.profile import DOWNLINK, UPLINK
from telepresence.link.queues import DEFAULT_LIMITS, DropPolicy
from telepresence.tmtc.pus.node import PusNode


def test_the_identifiers_of_both_links_are_fixed():
    # Recordings and other ends know them.
    assert (UPLINK.frame_octets, UPLINK.scid, UPLINK.vcid) == (32, 75, 0)
    assert (DOWNLINK.frame_octets, DOWNLINK.scid, DOWNLINK.vcid) == (500, 76, 1)
    assert UPLINK.pointer_in_vcid and not DOWNLINK.pointer_in_vcid


def test_queues_hold_what_the_documents_say():
    limits = {
        level: (one.depth_octets, one.max_age_ns, one.policy, one.rate_bps, one.burst_octets)
        for level, one in DEFAULT_LIMITS.items()
    }
    oldest, newest = DropPolicy.DROP_OLDEST, DropPolicy.REJECT_NEWEST
    assert limits == {
        Level.TMTC: (8_192, 10 * NS_PER_S, newest, 8_000, 512),
        Level.VOICE: (4_096, 100 * NS_PER_MS, oldest, None, None),
        Level.VIDEO: (65_536, 500 * NS_PER_MS, oldest, None, None),
        Level.MAINTENANCE: (65_536, 60 * NS_PER_S, newest, None, None),
    }


@pytest.mark.parametrize("rate_bps", [0, -1])
def test_telemetry_without_a_rate_is_refused(rate_bps):
    with pytest.raises(ConfigError, match="a rate above 0"):
        PusNode(rate_bps=rate_bps)

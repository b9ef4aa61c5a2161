"""What a session's link promises: delays, waits, headers, goodput and recovery, on short runs."""

import pytest
from link_figures import (
    HAPTIC,
    goodput,
    haptic_delays,
    haptic_difference,
    header_octets,
    resumptions,
    voice_waits,
)

from pipelines.bench.link import VIDEO
from telepresence.link.profile import DOWNLINK, UPLINK
from telepresence.link.radio import RadioPath

MS = 1_000_000


def test_saturated_media_delay_no_haptic_sample():
    found = haptic_difference(1.0, delay_ns=3 * MS)
    assert found.largest_slots == 0
    assert found.samples > 1980
    assert found.delay_ms == (3.0, 3.0)


def test_a_slower_radio_shows_in_the_delays():
    def delays(delay_ns):
        path = [RadioPath(delay_ns=delay_ns), RadioPath(delay_ns=delay_ns)]
        return haptic_delays(0.2, saturated=False, radio=path)

    assert max(delays(4 * MS)) - max(delays(3 * MS)) == MS


@pytest.mark.parametrize("profile", [UPLINK, DOWNLINK], ids=lambda profile: profile.name)
def test_voice_waits_at_most_two_slots(profile):
    waits = voice_waits(4.0, profile)
    assert len(waits) > 190
    assert 0 <= min(waits) <= max(waits) <= 2 * MS


def test_a_saturated_flow_uses_the_whole_zone():
    for profile in (UPLINK, DOWNLINK):
        found = goodput(0.5, profile, flow=VIDEO, payload_octets=1000, haptics=True)
        assert found.packets >= 0.99
        assert sum(found.shares()) == pytest.approx(1, abs=1e-9)


def test_compressed_headers_take_at_most_three_octets_and_two_on_average():
    counted = header_octets(20.0)
    assert max(found.most_compressed for found in counted.values()) <= 3
    packets = sum(found.packets for found in counted.values())
    octets = sum(found.mean * found.packets for found in counted.values())
    assert octets / packets <= 2.0
    assert all(found.whole <= 0.02 * found.packets + 3 for found in counted.values())


@pytest.mark.parametrize("blackout_s", [0.1, 1.0])
def test_the_link_recovers_with_the_first_good_frame_and_delivers_nothing_stale(blackout_s):
    found = resumptions(blackout_s, blackouts=5, delay_ns=3 * MS)
    assert len(found.noticed) == 10
    assert max(found.noticed) <= 50 * MS
    assert found.first[HAPTIC] == [0] * 10
    assert all(len(values) == 10 for values in found.first.values())
    assert max(max(values) for values in found.first.values()) <= 100 * MS
    assert found.stale == 0
    assert found.packets > 1000

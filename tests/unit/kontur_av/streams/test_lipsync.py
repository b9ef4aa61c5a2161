"""Lip-sync: how long sound waits for pictures, and the reported share of time in sync."""

import pytest

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.streams.lipsync import EARLIEST_NS, LipSync
from pipelines.report.journeys import LipSyncShare

MS = NS_PER_MS


def watching(latencies_ms, *, begin_ms=0):
    lip_sync = LipSync(oldest_picture_ns=300 * MS, oldest_sound_ns=150 * MS)
    for number, latency_ms in enumerate(latencies_ms):
        lip_sync.handle_picture((begin_ms + 33 * number) * MS, latency_ms * MS)
    return lip_sync


def test_sound_waits_for_pictures_only_as_long_as_needed():
    assert LipSync(oldest_picture_ns=300, oldest_sound_ns=150).least_latency_ns(0) is None
    least_ns = watching([120] * 60).least_latency_ns(2 * NS_PER_S)
    assert 120 * MS - EARLIEST_NS <= least_ns <= 125 * MS - EARLIEST_NS
    # Pictures within 40 ms: sound of any latency is in sync.
    assert watching([40] * 60).least_latency_ns(2 * NS_PER_S) <= 0


def test_a_single_late_picture_delays_no_sound_and_one_too_old_never_does():
    calm = watching([60] * 60).least_latency_ns(2 * NS_PER_S)
    assert watching([60] * 58 + [250, 60]).least_latency_ns(2 * NS_PER_S) == calm
    assert watching([500] * 60).least_latency_ns(2 * NS_PER_S) is None
    # If most pictures are too late to be useful, the others do not matter.
    assert watching([500, 200, 500] * 20).least_latency_ns(2 * NS_PER_S) is None
    assert watching([200, 500, 200] * 20).least_latency_ns(2 * NS_PER_S) is not None


def test_sound_never_becomes_too_old_and_missing_pictures_delay_nothing():
    lip_sync = watching([290] * 60)
    assert lip_sync.least_latency_ns(2 * NS_PER_S) <= 155 * MS
    assert lip_sync.least_latency_ns(5 * NS_PER_S) is None


def test_the_share_counts_time_not_pictures():
    share = LipSyncShare()
    # A second in sync, a tenth too early, two tenths too late.
    for at_ms, skew_ms in ((0, -45), (500, 125), (1000, -46), (1100, 126), (1300, 0)):
        share.add(at_ms * MS, skew_ms * MS)
    summary = share.summary()
    assert summary.within == pytest.approx(1000 / 1300, abs=1e-5)
    assert summary.early == pytest.approx(100 / 1300, abs=1e-5)
    assert summary.late == pytest.approx(200 / 1300, abs=1e-5)
    # A picture that is never replaced counts for half a second.
    share.add(100 * NS_PER_S, 0)
    assert share.counted_ns == 1800 * MS


def test_sound_is_45_ms_before_pictures_and_a_margin_of_3_ms():
    assert EARLIEST_NS == 45 * MS  # ITU-R BT.1359-1
    lip_sync = watching([120] * 60)
    last_ns = 33 * 59 * MS
    # The last picture counts for 2 s.
    for at_ns, least_ns in ((last_ns, 78 * MS), (last_ns + 2 * NS_PER_S - 1, 78 * MS)):
        assert lip_sync.least_latency_ns(at_ns) == least_ns
    assert lip_sync.least_latency_ns(last_ns + 2 * NS_PER_S) is None
    assert watching([299] * 60).least_latency_ns(0) == 153 * MS
    assert watching([300] * 60).least_latency_ns(0) is None
    # 95 % of the pictures are in time.
    assert watching([60] * 38 + [100] * 3).least_latency_ns(0) == 58 * MS
    assert watching([60] * 38 + [100] * 2).least_latency_ns(0) == 18 * MS
    # Half of them is not most.
    assert watching([60, 500] * 20).least_latency_ns(0) is None

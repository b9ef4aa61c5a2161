"""A session on two machines beside the same on one: medians, the target, losses, and the clock."""

from benchmarks.machines.figures import (
    MachinesResult,
    SessionFigures,
    StreamFigures,
    headlines,
)


def session(latency_ms, *, lost=0, over_cap_bps=0, error_ms=None):
    latencies = {"p50": latency_ms, "p99": 2 * latency_ms}
    stream = StreamFigures(latency_ms=latencies, packets=100, lost=lost, over_cap_bps=over_cap_bps)
    return SessionFigures(
        streams={"uplink_video": stream},
        haptic_ms={"up": latencies, "down": latencies},
        samples_lost={"up": 0, "down": 0},
        clock_offset_ms=None if error_ms is None else -error_ms / 2,
        latency_error_ms=error_ms,
        failures=(),
    )


def figures(one, two):
    result = MachinesResult(
        setup="mine", seconds=20, delay_ms=10, hosts="two", one=tuple(one), two=tuple(two)
    )
    return {(line.what, line.who): (line.value, line.met) for line in headlines(result)}


def test_a_latency_may_differ_by_3_ms_either_way():
    one = [session(latency_ms) for latency_ms in (40, 10, 41)]
    found = figures(one, [session(latency_ms) for latency_ms in (43, 43, 90)])
    assert found["uplink_video, capture to display, p50", "difference"] == (3, True)
    assert found["uplink_video, capture to display, p99", "difference"] == (6, False)
    assert found["force, one way, p99", "difference"] == (6, False)
    found = figures([session(40)], [session(36)])
    assert found["motion, one way, p50", "difference"] == (-4, False)


def test_one_lost_packet_or_one_second_over_a_cap_is_a_miss():
    found = figures([session(40)] * 2, [session(40), session(40, lost=1, over_cap_bps=8)])
    assert found["RTP packets lost", "one machine"] == (0, True)
    assert found["RTP packets lost", "two machines"] == (1, False)
    assert found["payload over a cap, any second", "two machines"] == (8, False)


def test_the_error_of_the_clocks_is_shown_where_it_is_known():
    stated = "error of latencies between the clocks, as stated", "two machines"
    assert stated not in figures([session(40)], [session(40)])
    found = figures([session(40)], [session(40, error_ms=each) for each in (0.2, 0.6, 0.4)])
    assert found[stated] == (0.4, None)
    assert found["offset of the clock, as estimated (in truth 0)", "two machines"] == (0.2, None)

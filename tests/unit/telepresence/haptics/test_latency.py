"""Latencies: stamps of both ends are matched by their numbers."""

from telepresence.haptics.latency import LatencyMatcher

MS = 1_000_000


def test_latencies_match_across_a_wrap_and_in_any_order_of_batches():
    matcher = LatencyMatcher()

    def matches(now_ns):
        return [ns for _, ns in matcher.take_matches_ns(now_ns)]

    matcher.handle_received([(65535, 7 * MS), (0, 9 * MS)])
    assert matches(9 * MS) == []
    matcher.handle_sent([(65535, 2 * MS), (0, 3 * MS)])
    assert [matcher.sent_ns(number) for number in (65535, 0, 1)] == [2 * MS, 3 * MS, None]
    assert matches(10 * MS) == [5 * MS, 6 * MS]
    a_turn_later = 65_536 * MS
    matcher.handle_received([(0, a_turn_later + 9 * MS)])
    assert matches(a_turn_later + 9 * MS) == []
    matcher.handle_sent([(0, a_turn_later + 3 * MS)])
    assert matches(a_turn_later + 10 * MS) == [6 * MS]
    matcher.handle_received([(5, a_turn_later)])
    assert matches(a_turn_later + 6_000 * MS) == []
    assert (matcher.unmatched, matcher.pending) == (1, 0)

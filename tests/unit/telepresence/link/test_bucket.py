"""No window of time carries more than its share and one burst, and nothing waits without need."""

from fractions import Fraction

from hypothesis import given
from hypothesis import strategies as st

from telepresence.link.bucket import Allowance, TokenBucket

MS = 1_000_000
BURST = 100


@given(
    st.lists(st.tuples(st.integers(0, 300), st.integers(1, BURST)), min_size=1, max_size=30),
    st.sampled_from([1_000, 8_000, 64_000]),
)
def test_octets_of_any_window(requests, rate_bps):
    bucket, tokens, now, sent = TokenBucket(rate_bps, BURST), Fraction(BURST), 0, []
    for pause_ms, octets in requests:
        now += pause_ms * MS
        tokens = min(Fraction(BURST), tokens + Fraction(pause_ms * rate_bps, 8000))
        assert bucket.holds(octets, now) == (octets <= tokens)
        if octets <= tokens:
            bucket.take(octets, now)
            tokens -= octets
            sent.append((now, octets))
    for first in range(len(sent)):
        for last in range(first, len(sent)):
            window = Fraction(sent[last][0] - sent[first][0], 10**9)
            octets = sum(octets for _, octets in sent[first : last + 1])
            assert octets <= BURST + window * rate_bps / 8


def test_what_exceeds_the_burst_needs_a_full_bucket():
    bucket = TokenBucket(8_000, 100)
    assert bucket.holds(300, 5 * MS)
    bucket.take(300, 5 * MS)
    assert not bucket.holds(101, 304 * MS)
    assert not bucket.holds(50, 254 * MS)
    assert bucket.holds(50, 255 * MS)
    assert bucket.holds(101, 305 * MS)


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

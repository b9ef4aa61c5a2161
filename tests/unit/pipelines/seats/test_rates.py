"""How many messages a page may send."""

from hypothesis import given
from hypothesis import strategies as st

from kontur_av.clock import NS_PER_S
from pipelines.seats.rates import MessageRate


def test_a_burst_then_the_rate():
    bucket = MessageRate(20, 5)
    assert [bucket.handle_message(0) for _ in range(6)] == [True] * 5 + [False]
    assert not bucket.handle_message(NS_PER_S // 20 - 1)
    assert bucket.handle_message(NS_PER_S // 20)
    assert not bucket.handle_message(NS_PER_S // 20)


@given(st.lists(st.integers(0, NS_PER_S), max_size=200))
def test_never_more_than_burst_and_rate(gaps_ns):
    bucket, now_ns, passed = MessageRate(20, 5), 0, 0
    for gap_ns in gaps_ns:
        now_ns += gap_ns
        passed += bucket.handle_message(now_ns)
        assert passed <= 5 + now_ns * 20 / NS_PER_S

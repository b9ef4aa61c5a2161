"""What waits for one page is bounded, units are complete or left out, and its messages are few."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kontur_av.clock import NS_PER_S
from pipelines.seats.open_page import MOST_UNIT_OCTETS, MOST_UNITS, ClientQueue, MessageRate


def drained(queue):
    found = []
    while (message := queue.pop()) is not None:
        found.append(message)
    return found


def test_the_most_urgent_goes_first_and_live_units_follow_the_replay():
    queue = ClientQueue([0])
    queue.put_preview(0, b"preview")
    queue.put_metrics("figures")
    queue.lanes[0].put_replay([b"unit"])
    queue.put_haptics(0, b"haptics")
    queue.put_sound(1, b"sound")
    queue.put_state("old")
    queue.put_state("state")
    queue.put_answer("hello")
    queue.put_pong(b"pong")
    assert len(queue) == 8
    assert drained(queue) == [
        *(b"pong", "hello", "state", b"sound", b"haptics", b"unit", "figures", b"preview")
    ]
    assert len(queue) == 0
    queue = ClientQueue([0])
    queue.lanes[0].put_unit(b"early", key=True)
    queue.lanes[0].put_replay([b"0", b"1"])
    queue.lanes[0].put_unit(b"2", key=False)
    assert drained(queue) == [b"0", b"1", b"2"]
    assert queue.units_left_out == 0
    # One of any size fits alone.
    queue.lanes[0].put_unit(bytes(MOST_UNIT_OCTETS + 1), key=True)
    assert queue.lanes[0].open and len(queue.lanes[0]) == 1


def test_units_that_do_not_fit_all_go_until_a_replay():
    queue = ClientQueue([0])
    lane = queue.lanes[0]
    lane.put_replay([b"0"])
    for number in range(MOST_UNITS + 1):
        lane.put_unit(b"%d" % number, key=False)
    assert (drained(queue), [at for at, lane in queue.lanes.items() if not lane.open]) == ([], [0])
    assert queue.units_left_out == 1 + MOST_UNITS + 1
    lane.put_unit(b"more", key=False)
    assert drained(queue) == []
    lane.put_replay([b"again"])
    lane.put_unit(b"next", key=False)
    assert drained(queue) == [b"again", b"next"]
    # So does a key unit.
    for number in range(MOST_UNITS + 1):
        lane.put_unit(b"%d" % number, key=False)
    lane.put_unit(b"key", key=True)
    lane.put_unit(b"next", key=False)
    assert drained(queue) == [b"key", b"next"]


@pytest.mark.rule("4")
def test_sound_loses_the_oldest_and_whoever_asks_and_does_not_read_is_noticed():
    queue = ClientQueue([])
    for number in range(17):
        queue.put_sound(1, b"%d" % number)
    assert drained(queue) == [b"%d" % number for number in range(2, 17)]
    assert queue.units_left_out == 2
    queue = ClientQueue([])
    for _ in range(65):
        assert not queue.overflowed
        queue.put_answer("answer")
    assert queue.overflowed


@given(st.lists(st.integers(0, NS_PER_S), max_size=200))
def test_a_burst_then_never_more_than_the_rate(gaps_ns):
    bucket = MessageRate(20, 5)
    assert [bucket.handle_message(0) for _ in range(6)] == [True] * 5 + [False]
    assert not bucket.handle_message(NS_PER_S // 20 - 1)
    assert bucket.handle_message(NS_PER_S // 20)
    bucket, now_ns, passed = MessageRate(20, 5), 0, 0
    for gap_ns in gaps_ns:
        now_ns += gap_ns
        passed += bucket.handle_message(now_ns)
        assert passed <= 5 + now_ns * 20 / NS_PER_S

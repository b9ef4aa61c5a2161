"""The application link: idle, one-way, broken, and approved again."""

import pytest
from link_supervision_pair import CONNECTED, GROUND, MS, SPACE, Pair, S, connected

from telepresence.link.supervision.message import MessageKind
from telepresence.link.supervision.record import ApplicationReset, StateChanged
from telepresence.link.supervision.supervisor import Supervisor


def test_a_link_without_programs_idles_for_minutes_and_then_works_at_once():
    pair = Pair()
    for end in pair.ends:
        end.sends = False
    pair.start()
    pair.run(5 * S)
    sent = [len(end.sent) for end in pair.ends]
    changes = [len(end.of(StateChanged)) for end in pair.ends]
    pair.run(90 * S)
    assert pair.states == ("APPROVE", "APPROVE")
    for end, messages, changed in zip(pair.ends, sent, changes, strict=True):
        assert len(end.sent) - messages <= 2 * 90
        assert len(end.of(StateChanged)) == changed
        assert not end.of(ApplicationReset)
    for end in pair.ends:
        end.sends = True
    pair.run(40)
    assert pair.states == CONNECTED


@pytest.mark.parametrize("sends", ["ground", "space"])
def test_one_way_data_is_no_fault(sends):
    pair = Pair()
    for end in pair.ends:
        end.sends = end.name == sends
    pair.start()
    pair.run(20 * S)
    assert pair.states == ("APPROVE", "APPROVE")
    for end in pair.ends:
        assert not end.of(ApplicationReset)
    # A packet in the other direction every five seconds, as with RTCP, keeps it connected.
    for end in pair.ends:
        if not end.sends:
            end.sends, end.period = True, 5 * S
    pair.run(6 * S)
    assert pair.states == CONNECTED
    changes = [len(end.of(StateChanged)) for end in pair.ends]
    pair.run(20 * S)
    assert changes == [len(end.of(StateChanged)) for end in pair.ends]


@pytest.mark.parametrize("first", ["ground", "space"])
def test_an_idle_link_is_reset_once_and_approved_again_by_data_both_ways(first):
    pair = connected()
    for end in pair.ends:
        end.sends = False
    pair.run(20 * S)
    assert pair.states == ("APPROVE", "APPROVE")
    resets = pair.ground.of(ApplicationReset) + pair.space.of(ApplicationReset)
    assert {reset.why for reset in resets} == {"idle"}
    assert max(len(end.of(ApplicationReset)) for end in pair.ends) == 1
    for end in pair.ends:
        end.sends = end.name == first
    pair.run(3 * S)
    assert pair.states == ("APPROVE", "APPROVE")
    for end in pair.ends:
        end.sends = True
    pair.run(50)
    assert pair.states == CONNECTED


def test_a_broken_application_link_is_reset_at_growing_intervals():
    pair = connected()

    # The ground's data is lost between the receiver and the applications in space.
    def arrive(end, life, message, data, now_ns):
        Pair.arrive(pair, end, life, message, None if end is pair.space else data, now_ns)

    pair.arrive = arrive
    pair.run(100 * S)
    assert pair.states == ("APPROVE", "APPROVE")
    resets = [event.now_ns for event in pair.space.of(ApplicationReset)]
    assert {event.why for event in pair.space.of(ApplicationReset)} == {"broken"}
    assert 3 <= len(resets) <= 6
    assert 2 * S * MS <= resets[1] - resets[0] < resets[-1] - resets[-2]
    assert not pair.ground.of(ApplicationReset)
    del pair.arrive
    pair.run(50)
    assert pair.states == CONNECTED


def test_an_unconfirming_slave_is_configured_again_at_growing_intervals():
    supervisor = Supervisor(master=True, configuration=GROUND, life=5, now_ns=0)
    supervisor.handle_local_check(None, 0)
    slave = Supervisor(master=False, configuration=SPACE, life=6, now_ns=0)
    slave.handle_local_check(None, 0)
    slave.handle_message(supervisor.poll_transmit(0), 0)
    # The slave hears its master, and has not been configured yet.
    assert slave.poll_transmit(10 * MS)[0] & 0xF == MessageKind.HELLO
    stuck = slave.poll_transmit(20 * MS)
    for slot in range(1, 100 * S):
        supervisor.handle_frame(slot * MS)
        if slot % 20 == 0:
            supervisor.handle_message(stuck, slot * MS)
        supervisor.poll_transmit(slot * MS)
    report = supervisor.report(100 * S * MS)
    assert report.state == "configure"
    assert 3 <= report.counts["timeouts_answer"] <= 6
    assert any("time-out" in entry["why"] for entry in report.history)

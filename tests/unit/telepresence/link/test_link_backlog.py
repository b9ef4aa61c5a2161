"""Reports to the senders: their rate, their rounding, on changes and twice a second."""

from itertools import pairwise
from random import Random

from virtual_link import VirtualLink

from telepresence.link.flows import Level, packet_flow
from telepresence.link.gateway import (
    FREED_STEP_BPS,
    REPEAT_NS,
    REPORT_NS,
    Backlog,
    BacklogReporter,
)

MS = 1_000_000
SLOTS = 5500


def truth(gateway):
    """Return the exact present state."""
    return Backlog(
        gateway.sender.waiting_octets(Level.VIDEO) + gateway.sender.begun_octets(Level.VIDEO),
        gateway.contacts,
        gateway.supervisor.signal,
        gateway.freed_bps,
    )


def rounded(backlog):
    return backlog._replace(freed_bps=backlog.freed_bps // FREED_STEP_BPS * FREED_STEP_BPS)


def session(seed=1):
    """Run some seconds with video and missing samples: (instant, exact state, report)."""
    link = VirtualLink(
        uplink_flows=[packet_flow("picture", Level.VIDEO)],
        downlink_flows=[packet_flow("command", Level.TMTC)],
    )
    chance = Random(seed)
    reporter = BacklogReporter(link.ground)
    reports = []
    for slot in range(SLOTS):
        # A picture now and then, one second without samples, and more without any change.
        busy = slot < 3000
        if busy and chance.random() < 0.02:
            link.ground.handle_datagram("picture", bytes(chance.randrange(50, 900)), link.now_ns)
        if not busy or (slot < 2000 and chance.random() < 0.7):
            link.ground.handle_haptic(bytes(12), link.now_ns)
        now_ns = link.now_ns
        for _ in link.step():
            pass
        reports.append((now_ns, truth(link.ground), reporter.poll_transmit(now_ns)))
    return reports


def test_reports_only_changes_at_most_every_four_milliseconds():
    messages = [(now_ns, message) for now_ns, _, message in session() if message is not None]
    assert len(messages) > 200
    for (earlier_ns, earlier), (later_ns, later) in pairwise(messages):
        assert later_ns - earlier_ns >= 4 * MS == REPORT_NS
        assert later != earlier or later_ns - earlier_ns == REPEAT_NS
    # Sometimes a change is reported at the earliest allowed instant.
    assert min(b[0] - a[0] for a, b in pairwise(messages)) == 4 * MS


def test_freed_capacity_is_rounded_down():
    messages = [(true, message) for _, true, message in session() if message is not None]
    freed = {message.freed_bps for _, message in messages}
    assert len(freed) > 10
    assert all(bps % 1000 == 0 for bps in freed)
    for true, message in messages:
        assert 0 <= true.freed_bps - message.freed_bps < 1000
        assert message == rounded(true)
    # Some exact values are not round; without them this test would show nothing.
    assert any(true.freed_bps % 1000 for true, _ in messages)


def test_a_change_is_reported_within_four_milliseconds():
    known = None
    wrong_since_ns = None
    for now_ns, true, message in session():
        known = message or known
        if known == rounded(true):
            wrong_since_ns = None
        elif wrong_since_ns is None:
            wrong_since_ns = now_ns
        else:
            assert now_ns - wrong_since_ns < 4 * MS


def test_without_a_change_the_state_is_repeated_for_a_process_that_was_started_since():
    # In the last seconds every slot has a sample. Once the window holds no other, nothing changes.
    reports = session()
    last = rounded(reports[-1][1])
    quiet_ns = next(ns for ns, true, _ in reports[::-1] if rounded(true) != last) + 4 * MS
    again = [(ns, message) for ns, _, message in reports if message and ns > quiet_ns]
    assert len(again) >= 2
    assert all(message == last for _, message in again)
    assert all(b[0] - a[0] == REPEAT_NS for a, b in pairwise(again))


def test_the_first_slot_reports_the_state():
    _, true, message = session()[0]
    assert message == rounded(true)


def test_a_picture_that_a_telecommand_interrupts_counts_until_it_has_left():
    link = VirtualLink(
        uplink_flows=[packet_flow("picture", Level.VIDEO), packet_flow("command", Level.TMTC)],
        downlink_flows=[packet_flow("state", Level.TMTC)],
    )
    reporter = BacklogReporter(link.ground)
    waiting = []
    for slot in range(80):
        if slot == 5:
            link.ground.handle_datagram("picture", bytes(360), link.now_ns)
        if slot == 15:
            link.ground.handle_datagram("command", bytes(120), link.now_ns)
        link.ground.handle_haptic(bytes(12), link.now_ns)
        now_ns = link.now_ns
        for _ in link.step():
            pass
        report = reporter.poll_transmit(now_ns)
        if report is not None:
            waiting.append((slot, report.waiting_octets))
    # 360 octets take 30 slots of 12, and the telecommand 10 of them.
    last = next(slot for slot, octets in waiting if slot > 10 and octets == 0)
    assert 44 <= last <= 50
    after = [(slot, octets) for slot, octets in waiting if 16 < slot < last]
    assert len(after) > 5
    assert all(abs(octets - 12 * (last - slot)) < 60 for slot, octets in after)

"""The record of states, contacts and gaps adds up."""

from telepresence.link.supervision.message import LinkState
from telepresence.link.supervision.record import SupervisionRecord

MS, S = 1_000_000, 1_000_000_000


def test_the_record_adds_up():
    record = SupervisionRecord(LinkState.CHECK, "starts", 10 * S)
    record.handle_state(LinkState.SEARCH, "checked", 11 * S)
    assert record.handle_signal_acquired(13 * S) == 3 * S
    # No signal was lost before the first one, so there was no gap.
    assert (record.longest_gap_ns, record.contact_ns(15 * S)) == (0, 2 * S)
    record.handle_state(LinkState.CONNECTED, "data", 14 * S)
    record.handle_state(LinkState.CONNECTED, "again", 15 * S)
    record.handle_signal_lost(16 * S)
    record.handle_state(LinkState.SEARCH, "lost", 17 * S)
    assert record.contact_ns(20 * S) == 3 * S
    assert record.handle_signal_acquired(21 * S) == 5 * S
    record.handle_signal_lost(22 * S)
    assert record.handle_signal_acquired(23 * S) == S
    assert record.longest_gap_ns == 5 * S and record.contact_ns(24 * S) == 5 * S
    assert record.since_ns == 7 * S
    times = record.in_state_ns(24 * S)
    assert {name: ns // S for name, ns in times.items() if ns} == {
        "check": 1,
        "search": 10,
        "connected": 3,
    }
    assert [(one.acquired_ns // S, one.connected_ns, one.lost_ns) for one in record.contacts] == [
        (3, 4 * S, 6 * S),
        (11, None, 12 * S),
        (13, None, None),
    ]
    assert [tuple(one.values()) for one in record.history][:3] == [
        (0, "check", "check", "starts"),
        (S, "check", "search", "checked"),
        (4 * S, "search", "connected", "data"),
    ]
    assert (record.counts["signals_acquired"], record.counts["signals_lost"]) == (3, 2)
    for number in range(100):
        record.handle_state(LinkState.SEARCH, str(number), 30 * S)
    assert len(record.history) == 64 and record.history[-1]["why"] == "99"

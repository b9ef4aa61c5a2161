"""The counts of supervision in the report: each equals what happened."""

import pytest
from link_supervision_pair import CONNECTED, MS, Pair, S, connected

from telepresence.link.supervision.record import (
    ApplicationReset,
    PeerDeaf,
    PeerHears,
    PeerMet,
    SignalAcquired,
    SignalLost,
    StateChanged,
)


def figures(pair, end):
    return end.supervisor.report(pair.slot * MS)


def assert_counted(pair, end):
    """The counts of an end are those of its events, since it was started."""
    report = figures(pair, end)
    counts = dict(report.counts)
    causes = [event.why for event in end.of(StateChanged)]
    assert counts.pop("messages_sent") == len(end.sent)
    assert counts.pop("signals_acquired") == len(end.of(SignalAcquired))
    assert counts.pop("signals_lost") == len(end.of(SignalLost))
    assert counts.pop("peer_restarts") == sum(event.restarted for event in end.of(PeerMet))
    assert counts.pop("peer_deaf") == len(end.of(PeerDeaf))
    for why in ("idle", "broken"):
        resets = [event for event in end.of(ApplicationReset) if event.why == why]
        assert counts.pop(f"resets_{why}") == len(resets)
    assert counts.pop("timeouts_answer") == sum(
        why.startswith("time-out: the slave") for why in causes
    )
    assert counts.pop("timeouts_silence") == sum(
        why.startswith("time-out: frames") for why in causes
    )
    assert set(counts) == {"messages_received", "messages_malformed", "messages_mismatched"}
    assert len(report.contacts) == len(end.of(SignalAcquired))
    assert sum(report.in_state_ns.values()) == pair.slot * MS - report.begun_ns


def test_messages_are_counted_at_both_ends():
    pair = connected()
    pair.run(5 * S)
    for end, other in (pair.ends, pair.ends[::-1]):
        assert_counted(pair, end)
        on_the_way = sum(message is not None for _, _, message, _ in pair.paths[other.name])
        counts = figures(pair, end).counts
        assert counts["messages_received"] == len(other.sent) - on_the_way
        assert counts["messages_malformed"] == counts["messages_mismatched"] == 0


def test_garbled_messages_are_counted_as_such():
    pair = connected()
    before = {end.name: figures(pair, end).counts for end in pair.ends}
    now_ns = pair.slot * MS
    for _ in range(3):
        pair.ground.supervisor.handle_message(bytes(12), now_ns)
    counts = figures(pair, pair.ground).counts
    assert counts["messages_malformed"] == before["ground"]["messages_malformed"] + 3
    assert counts["messages_received"] == before["ground"]["messages_received"]


@pytest.mark.parametrize("who", ["ground", "space"])
def test_each_restart_of_the_peer_is_counted(who):
    pair = connected()
    one, other = pair.ends if who == "ground" else pair.ends[::-1]
    for number in (1, 2, 3):
        one.events.clear()
        one.sent.clear()
        one.start(0x7000 + number, pair.slot)
        pair.run(3 * S)
        assert pair.states == CONNECTED
        assert figures(pair, other).counts["peer_restarts"] == number
        assert figures(pair, one).counts["peer_restarts"] == 0
        for end in pair.ends:
            assert_counted(pair, end)


def test_each_time_without_hearing_is_counted_at_both_ends():
    pair = connected()
    for number in (1, 2, 3):
        begun_ns = pair.slot * MS
        pair.blocked["ground"] = True
        pair.run(number * S)
        pair.blocked["ground"] = False
        pair.run(2 * S)
        assert pair.states == CONNECTED
        # Space lost the signal, and the ground heard that space does not hear it.
        space, ground = figures(pair, pair.space), figures(pair, pair.ground)
        assert (space.counts["signals_lost"], space.counts["signals_acquired"]) == (
            number,
            number + 1,
        )
        assert (ground.counts["peer_deaf"], ground.counts["signals_lost"]) == (number, 0)
        assert len(pair.ground.of(PeerHears)) == number + 1
        assert (pair.space.of(SignalLost)[-1].now_ns - begun_ns) // MS in range(40, 60)
        assert number * S - 5 <= space.longest_gap_ns // MS <= number * S + 5
        for end in pair.ends:
            assert_counted(pair, end)
    gaps_ns = sum(
        again.acquired_ns - lost.lost_ns
        for lost, again in zip(space.contacts, space.contacts[1:], strict=False)
    )
    begun_ns = space.contacts[0].acquired_ns
    assert space.contact_ns == pair.slot * MS - space.begun_ns - begun_ns - gaps_ns


def test_resets_and_silence_are_counted():
    pair = connected()
    for end in pair.ends:
        end.sends = False
    pair.run(20 * S)
    assert sum(figures(pair, end).counts["resets_idle"] for end in pair.ends) > 0
    for end in pair.ends:
        assert_counted(pair, end)
    # Frames, but no messages.
    pair.message_loss = 1.0
    pair.run(11 * S)
    assert figures(pair, pair.ground).counts["timeouts_silence"] > 0
    for end in pair.ends:
        assert_counted(pair, end)


def test_broken_applications_are_counted():
    pair = connected()

    def arrive(end, life, message, data, now_ns):
        Pair.arrive(pair, end, life, message, None if end is pair.space else data, now_ns)

    pair.arrive = arrive
    pair.run(30 * S)
    assert figures(pair, pair.space).counts["resets_broken"] > 1
    for end in pair.ends:
        assert_counted(pair, end)

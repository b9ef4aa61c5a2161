"""Losses of signal, a single working direction, and any other disturbances."""

from random import Random

import pytest
from link_supervision_pair import CONNECTED, MS, Pair, S, connected

from telepresence.link.supervision.message import LinkState
from telepresence.link.supervision.record import (
    ApplicationReset,
    ContextsHeld,
    PeerDeaf,
    PeerHears,
    PeerMet,
    SignalLost,
    StateChanged,
)


@pytest.mark.parametrize("blackout", [100, 1_000, 10_000])
@pytest.mark.parametrize("delay_slots", [0, 12, 400])
def test_blackout_both_ways(blackout, delay_slots):
    pair = connected(delay_slots=delay_slots)
    pair.run(7)
    pair.blocked = dict.fromkeys(pair.blocked, True)
    pair.run(blackout)
    pair.blocked = dict.fromkeys(pair.blocked, False)
    back = (pair.slot + delay_slots) * MS
    for end in pair.ends:
        end.events.clear()
        end.delivered.clear()
    pair.run(3 * delay_slots + 100)
    for end in pair.ends:
        # A loss is noticed at the receiver, up to a delay after it began.
        record = end.supervisor.report(pair.slot * MS).contacts
        assert len(record) == 2
        assert record[1].acquired_ns - back <= MS
        assert record[1].acquired_ns - record[0].lost_ns == (blackout + 1) * MS
        if blackout > 50 + delay_slots:
            # The very first frame is delivered, because this life was checked before.
            assert end.delivered[0][0] == record[1].acquired_ns
    if delay_slots <= 12:
        assert pair.states == CONNECTED
    pair.run(1 * S)
    assert pair.states == CONNECTED
    for end in pair.ends:
        assert not end.of(PeerMet)


def test_loss_is_noticed_within_50_ms_of_the_last_frame():
    for slot in range(10):
        pair = connected(delay_slots=slot)
        pair.run(slot)
        pair.blocked["ground"] = True
        pair.run(60 + slot)
        (lost,) = pair.space.of(SignalLost)
        assert 0 < lost.now_ns - lost.last_ns <= 50 * MS
        assert not pair.ground.of(SignalLost)


@pytest.mark.parametrize("gap", [1, 20, 47])
def test_a_gap_below_the_limit_is_no_loss_of_signal(gap):
    pair = connected()
    pair.blocked = dict.fromkeys(pair.blocked, True)
    pair.run(gap)
    pair.blocked = dict.fromkeys(pair.blocked, False)
    pair.run(100)
    assert pair.states == CONNECTED
    assert not pair.ground.of(SignalLost) + pair.space.of(SignalLost)


@pytest.mark.parametrize("deaf", ["ground", "space"])
def test_one_working_direction_keeps_carrying(deaf):
    pair = connected(delay_slots=12)
    hearing, lost = pair.ends if deaf == "space" else pair.ends[::-1]
    # Frames of `hearing` no longer reach `lost`, but those of `lost` still arrive.
    pair.blocked[hearing.name] = True
    pair.run(200)
    assert lost.supervisor.state is LinkState.SEARCH
    assert hearing.supervisor.state is LinkState.CONFIGURE
    assert "does not hear" in hearing.supervisor.why
    assert not hearing.supervisor.peer_hears
    assert [type(event) for event in hearing.events if not isinstance(event, ContextsHeld)][
        -2:
    ] == [PeerDeaf, StateChanged]
    count = len(hearing.delivered)
    sent = len(lost.sent)
    pair.run(10 * S)
    assert len(hearing.delivered) - count == 10 * S
    # Messages to a peer that may not hear are limited, because media share the capacity.
    assert len(lost.sent) - sent <= 10 * 20 + 100
    pair.blocked[hearing.name] = False
    pair.run(100 + 3 * 12)
    assert pair.states == CONNECTED
    assert lost.of(PeerHears)
    assert hearing.of(PeerHears)


def test_one_working_direction_from_the_beginning():
    pair = Pair()
    pair.blocked["space"] = True
    pair.start()
    pair.run(100)
    assert pair.space.delivered[0][0] < 30 * MS
    assert pair.states == ("SEARCH", "CONFIGURE")
    pair.never_connected = True
    pair.run(20 * S)
    assert not pair.ground.delivered
    assert len(pair.space.of(StateChanged)) == 2


def test_single_wrong_messages_break_nothing():
    pair = connected()
    pair.garble = 0.5
    events = len(pair.ground.events)
    pair.run(40 * S)
    assert pair.states == CONNECTED
    for end in pair.ends:
        counts = end.supervisor.report(pair.slot * MS).counts
        assert counts["messages_malformed"] + counts["messages_mismatched"] > 20
        assert not end.of(PeerDeaf) + end.of(SignalLost) + end.of(ApplicationReset)
        assert len(end.of(PeerMet)) == 1
    assert len(pair.ground.events) > events


@pytest.mark.parametrize("seed", range(8))
def test_it_ends_connected_after_any_disturbances(seed):
    """Blackouts, lost and corrupted messages, restarts, faults; then no more disturbances."""
    random = Random(seed)
    pair = Pair(delay_slots=random.choice((0, 1, 7, 40, 130, 400)))
    pair.message_loss, pair.garble = random.choice((0.0, 0.3)), random.choice((0.0, 0.1))
    pair.random = Random(seed + 1000)
    life = 1
    pair.start()
    for _ in range(30):
        what = random.randrange(6)
        end = random.choice(pair.ends)
        if what < 2:
            pair.blocked[end.name] = not pair.blocked[end.name]
        elif what == 2:
            pair.blocked = dict.fromkeys(pair.blocked, random.random() < 0.5)
        elif what == 3:
            life += 1
            end.start(life, pair.slot)
        elif what == 4:
            fault = random.choice((None, "a fault"))
            end.supervisor.handle_local_check(fault, pair.slot * MS)
        else:
            end.sends = not end.sends
        for _ in range(random.choice((1, 30, 60, 300, 2000))):
            pair.step()
            for one in pair.ends:
                if one.supervisor.state is LinkState.CONNECTED:
                    assert one.supervisor.signal
                    assert one.supervisor.peer_hears
                    assert one.supervisor.delivering
    pair.blocked = dict.fromkeys(pair.blocked, False)
    for end in pair.ends:
        end.supervisor.handle_local_check(None, pair.slot * MS)
        end.sends = True
    pair.run(4 * pair.delay_slots + 1500)
    assert pair.states == CONNECTED
    changes = [len(end.of(StateChanged)) for end in pair.ends]
    resets = [len(end.of(ApplicationReset)) for end in pair.ends]
    pair.run(10 * S)
    assert changes == [len(end.of(StateChanged)) for end in pair.ends]
    assert resets == [len(end.of(ApplicationReset)) for end in pair.ends]


def test_equal_runs_give_equal_reports():
    reports = []
    for _ in range(2):
        pair = connected(delay_slots=12)
        pair.message_loss = 0.3
        pair.blocked["ground"] = True
        pair.run(300)
        pair.blocked["ground"] = False
        pair.run(300)
        reports.append([end.supervisor.report(pair.slot * MS) for end in pair.ends])
    assert reports[0] == reports[1]
    ground = reports[0][0]
    assert sum(ground.in_state_ns.values()) == pair.slot * MS
    assert len(ground.history) <= 64

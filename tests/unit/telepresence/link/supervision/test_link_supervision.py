"""How two ends of the link find each other, what they send then, and how a restart is handled."""

from itertools import pairwise

import pytest
from link_supervision_pair import CONNECTED, MS, SPACE, Pair, S, connected

from telepresence.link.supervision.message import (
    LinkState,
    MessageKind,
    SupervisionTiming,
    parse_message,
)
from telepresence.link.supervision.negotiation import Proof
from telepresence.link.supervision.record import (
    ApplicationReset,
    ContextsHeld,
    PeerDeaf,
    PeerDoubted,
    PeerHears,
    PeerMet,
    SignalAcquired,
    SignalLost,
)
from telepresence.link.supervision.supervisor import Encounter, Supervisor


@pytest.mark.parametrize("delay_slots", [0, 5, 15, 400])
def test_connects_in_two_round_trips_and_a_few_messages(delay_slots):
    pair = Pair(delay_slots=delay_slots)
    pair.start()
    while pair.states != CONNECTED:
        pair.step()
    assert pair.slot <= 5 * delay_slots + 100
    for end in pair.ends:
        states = pair.history(end)
        assert states[:3] == ["check", "search", "configure"]
        # Data that arrived before the two had agreed approves the link at once.
        assert states[3:] in (["connected"], ["approve", "connected"])
        assert len(end.of(SignalAcquired)) == len(end.of(PeerMet)) == len(end.of(PeerHears)) == 1
        assert not end.of(SignalLost) + end.of(PeerDeaf) + end.of(ApplicationReset)


@pytest.mark.parametrize("late", [30, 700, 10_000])
@pytest.mark.parametrize("first", ["ground", "space"])
def test_connects_for_any_start_delay(late, first):
    pair = Pair(delay_slots=12)
    one, other = pair.ends if first == "ground" else pair.ends[::-1]
    one.start(7, 0)
    pair.run(late)
    assert one.supervisor.state is LinkState.SEARCH
    other.start(8, pair.slot)
    pair.run(200)
    assert pair.states == CONNECTED


def test_when_settled_messages_are_rare():
    pair = connected()
    # Each knows that the other is connected, so frequent messages end.
    assert max(len(end.sent) for end in pair.ends) <= 8
    pair.run(3 * S)
    assert max(len(end.sent) for end in pair.ends) <= 8 + 7
    before = [len(end.sent) for end in pair.ends]
    events = [len(end.events) for end in pair.ends]
    pair.run(20 * S)
    for end, sent, seen in zip(pair.ends, before, events, strict=True):
        assert len(end.sent) - sent <= 40
        assert all(isinstance(event, ContextsHeld) for event in end.events[seen:])


@pytest.mark.parametrize("who", ["ground", "space"])
@pytest.mark.parametrize("delay_slots", [0, 5, 400])
def test_a_new_life_of_either_side(who, delay_slots):
    pair = connected(delay_slots=delay_slots)
    one, other = pair.ends if who == "ground" else pair.ends[::-1]
    other.supervisor.handle_contexts((9, 8), pair.slot * MS)
    pair.run(2 * S)
    assert one.of(ContextsHeld)[-1].ids == (9, 8, 0, 0)
    for end in pair.ends:
        end.events.clear()
    one.start(0x7777, pair.slot)
    pair.run(6 * delay_slots + 100)
    assert pair.states == CONNECTED
    (met,) = other.of(PeerMet)
    assert met[1:] == (0x7777, True)
    # Contexts of the former life are never acknowledged to the new one.
    assert {event.ids for event in one.of(ContextsHeld)} == {(0, 0, 0, 0)}
    assert not one.of(ApplicationReset) + other.of(ApplicationReset)


def test_another_life_in_the_peers_stream_must_prove_itself():
    """A single message may be a bit error that the FECF did not detect; the second ends it."""
    pair = connected()
    pair.run(1 * S)
    supervisor, other = pair.ground.supervisor, pair.space.supervisor
    stranger = Supervisor(
        master=False, configuration=other.configuration, life=0x5555, now_ns=0, secret=1
    )
    stranger.handle_local_check(None, 0)
    now_ns = pair.slot * MS
    supervisor.handle_message(stranger.poll_transmit(0), now_ns)
    pair.drain(pair.ground)
    assert pair.ground.followed == 0x2222
    supervisor.handle_message(stranger.poll_transmit(20 * MS), now_ns)
    pair.drain(pair.ground)
    assert (pair.ground.followed, supervisor.signal) == (None, False)
    assert len(pair.ground.of(PeerDoubted)) == len(pair.ground.of(SignalLost)) == 1
    # The peer answers, and nothing of its life has changed.
    pair.run(60)
    assert pair.states == CONNECTED
    assert len(pair.ground.of(PeerMet)) == 1


def test_a_number_counts_once_and_only_for_a_while():
    proof = Proof(seed=3, timing=SupervisionTiming(round_trip_ns=100 * MS))
    first = proof.number(0)
    assert proof.number(99 * MS) == first
    second = proof.number(100 * MS)
    assert second != first
    assert not proof.answers(0, 101 * MS)
    assert not proof.answers(first ^ second, 101 * MS)
    assert proof.answers(first, 199 * MS)
    assert not proof.answers(first, 199 * MS)
    third = proof.number(200 * MS)
    assert third not in (first, second)
    assert not proof.answers(second, 201 * MS)  # It went with the first.
    assert not proof.answers(third, 400 * MS)
    assert proof.number(401 * MS) != third
    assert proof.answers(third, 402 * MS) is False


def test_frames_without_messages_time_out():
    pair = connected()
    for slot in range(pair.slot, pair.slot + 10 * S):
        pair.ground.supervisor.handle_frame(slot * MS)
        pair.ground.supervisor.poll_transmit(slot * MS)
        pair.drain(pair.ground)
    assert pair.ground.supervisor.state is LinkState.SEARCH
    assert pair.ground.of(PeerDeaf)
    assert pair.ground.supervisor.delivering


def test_contexts_are_reported_at_once_and_again():
    pair = connected()
    pair.run(3 * S)
    pair.space.supervisor.handle_contexts((3, 0), pair.slot * MS)
    pair.run(7)
    assert pair.ground.of(ContextsHeld)[-1].ids == (3, 0, 0, 0)
    pair.ground.events.clear()
    pair.run(2 * S)
    assert {event.ids for event in pair.ground.of(ContextsHeld)} == {(3, 0, 0, 0)}
    # Contexts that change all the time do not use up the channel.
    sent = len(pair.space.sent)
    for number in range(S):
        pair.space.supervisor.handle_contexts((1 + number % 255,), pair.slot * MS)
        pair.step()
    assert len(pair.space.sent) - sent <= 51


@pytest.mark.parametrize(
    ("silent_ms", "frames", "lasts_ms", "hears", "followed"),
    [
        (None, 8, 20, False, True),
        (None, 7, 20, False, False),
        (None, 8, 19, False, False),
        (None, 5000, 5000, True, False),
        (2000, 8, 1000, False, True),
        (1999, 8, 1000, False, False),
        (2000, 8, 999, False, False),
        (2000, 7, 1000, False, False),
        (60_000, 5000, 5000, True, False),
    ],
)
def test_when_a_stranger_that_hears_nobody_is_followed(
    silent_ms, frames, lasts_ms, hears, followed
):
    """silent_ms: how long the peer has been silent; None: no peer was ever met."""
    pair = Pair()
    pair.start()
    if silent_ms is None:
        now_ns = 0
    else:
        pair.run(200)
        now_ns = pair.ground.supervisor._frame_ns + silent_ms * MS
        pair.ground.supervisor.poll_transmit(now_ns)
    stranger = Supervisor(master=False, configuration=SPACE, life=0x5555, now_ns=now_ns, secret=1)
    stranger.handle_local_check(None, now_ns)
    if hears:
        stranger.handle_frame(now_ns)
    message = stranger.poll_transmit(now_ns)
    supervisor = pair.ground.supervisor
    found = supervisor.handle_stranger(message, now_ns, frames=frames, lasts_ns=lasts_ms * MS)
    assert found is (Encounter.RESTART if followed else Encounter.IGNORE)


def test_a_stranger_beside_a_live_peer_is_asked_ten_times_a_second():
    """Also one without any message: it may be the peer, whose delay has fallen."""
    pair = connected()
    pair.run(3 * S)
    supervisor, asked = pair.ground.supervisor, []
    for slot in range(2000):
        lasts_ns = (slot + 1) * MS if slot < 1000 else 4 * MS
        supervisor.handle_stranger(None, pair.slot * MS, frames=slot + 1, lasts_ns=lasts_ns)
        sent = len(pair.ground.sent)
        pair.step()
        for at, message in pair.ground.sent[sent:]:
            told = parse_message(message)
            if told.kind is MessageKind.HELLO:
                asked.append(at)
                assert told.number
    assert len(asked) in (10, 11)
    assert min(b - a for a, b in pairwise(asked)) == 100
    # The peer's answers change nothing.
    assert pair.states == CONNECTED
    assert not pair.ground.of(PeerDoubted) + pair.ground.of(SignalLost)
    # Afterwards nobody asks and answers any more.
    sent = [len(end.sent) for end in pair.ends]
    pair.run(10 * S)
    assert max(len(end.sent) - n for end, n in zip(pair.ends, sent, strict=True)) <= 21


def test_a_refusal_ends_with_the_frames_that_caused_it():
    pair = Pair(masters=(True, True))
    pair.start()
    pair.run(500)
    assert pair.states == ("REFUSED", "REFUSED")
    pair.blocked = dict.fromkeys(pair.blocked, True)
    pair.run(200)
    assert pair.states == ("SEARCH", "SEARCH")

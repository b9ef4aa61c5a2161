"""Two protected channels on virtual time: what path and intruders do costs no genuine frame."""

from itertools import pairwise

import pytest
from protected_pair import (
    GROUND_ADDRESS,
    GROUND_KEY,
    MS,
    SPACE_ADDRESS,
    SPACE_KEY,
    ProtectedEnd,
    ProtectedPair,
    S,
    connected,
)

from telepresence.link.protection import datagrams
from telepresence.link.protection.channel import (
    OVERLAP_NS,
    HandshakeFailed,
    PeerMoved,
    SessionBegun,
)
from telepresence.link.protection.datagrams import (
    HANDSHAKE,
    KNOCK,
    RECORD,
    SEGMENT_OVERHEAD_OCTETS,
    SegmentCodec,
)
from telepresence.link.protection.identity import MachineKey

STRANGER_KEY = MachineKey.from_seed(bytes([2] * 32))
STRANGER = ("203.0.113.9", 4000)
BOTH = pytest.mark.parametrize("name", ["ground", "space"])
CALLED = pytest.mark.parametrize("space_called", [False, True], ids=["both know", "ground waits"])


def assert_counted_once(end):
    metrics = end.channel.metrics
    counted = metrics.opened + metrics.handshake_datagrams + sum(metrics.dropped.values())
    assert counted == end.received


def assert_nothing_lost(pair):
    """Every frame that was sealed comes, once and only from the peer."""
    before = [end.frames_sent for end in pair.ends]
    pair.run(2 * (pair.delay_ns + pair.jitter_ns) / S)
    for end, other, sent in zip(pair.ends, pair.ends[::-1], before, strict=True):
        assert len(set(other.got)) == len(other.got)
        assert {number for number in end.sealed if number <= sent} <= {*other.got}
        assert {*other.got} <= {*end.sealed}


def is_record(datagram):
    return datagram[0] == RECORD


def sessions(pair):
    return [len(end.of(SessionBegun)) for end in pair.ends]


@CALLED
@pytest.mark.parametrize("first", ["ground", "space"])
def test_either_end_may_start_first(first, space_called):
    pair = ProtectedPair(space_called=space_called)
    getattr(pair, first).start(0)
    pair.run(7)
    (pair.space if first == "ground" else pair.ground).start(pair.now_ns)
    # The longest time between two knocks, and the handshake.
    pair.run(2.2)
    assert sessions(pair) == [1, 1]
    assert_nothing_lost(pair)


@pytest.mark.parametrize("seed", range(4))
def test_a_bad_path_delays_the_session_and_harms_no_frame_that_it_delivers(seed):
    pair = ProtectedPair(
        seed=seed, lost=0.3, repeated=0.2, jitter_ns=60 * MS, rekey_ns=10 * S, delay_ns=50 * MS
    ).start()
    pair.run(60)
    for end, other in (pair.ends, pair.ends[::-1]):
        # One attempt takes about 2 s on this path.
        assert len(end.of(SessionBegun)) >= 4
        assert len(set(end.got)) == len(end.got) > 0.6 * len(other.sealed)
        # A repetition is dropped; nothing else of the peer's is.
        assert set(end.dropped) <= {"replayed", "stale"}
        assert_counted_once(end)


@pytest.mark.parametrize(
    "options",
    [
        {"rekey_records": 300},
        {"rekey_ns": 1500 * MS, "jitter_ns": 300 * MS},
        {"rekey_ns": 3 * S, "delay_ns": 600 * MS},
    ],
    ids=["records", "reordered", "far"],
)
def test_new_keys_cost_no_frame(options):
    pair = connected(**options).run(30)
    assert all(len(end.of(SessionBegun)) > 4 for end in pair.ends)
    assert_nothing_lost(pair)
    assert [set(end.dropped) - {"stale"} for end in pair.ends] == [set(), set()]


@pytest.mark.parametrize("after", range(0, 12, 2))
def test_a_handshake_that_breaks_off_anywhere_leaves_the_session(after):
    """This datagram of the second handshake and all after it are lost for a time."""
    pair, passed = connected(rekey_ns=5 * S), []

    def blocks(end, datagram):
        if is_record(datagram):
            return False
        passed.append(datagram)
        return len(passed) > after

    pair.blocks = blocks
    pair.run(26)
    pair.blocks = lambda end, datagram: False
    pair.run(6)
    assert_nothing_lost(pair)
    assert min(sessions(pair)) >= 2
    assert all(set(end.dropped) <= {"stale"} for end in pair.ends)


@CALLED
@BOTH
def test_a_restarted_end_is_found_again_and_earlier_sessions_stay_closed(name, space_called):
    pair = connected(space_called=space_called).run(3)
    earlier = list(pair.recorded)
    end = getattr(pair, name)
    end.start(pair.now_ns)
    # Silence of 2 s is what tells the other end; then the handshake.
    pair.run(2.5)
    assert sessions(pair) == [2, 2]
    sealed = len(end.sealed)
    pair.run(1)
    assert len(end.sealed) == sealed + 200
    before = [list(each.got) for each in pair.ends]
    for sender, datagram in earlier:
        other = pair.space if sender is pair.ground else pair.ground
        pair.inject(datagram, sender.address, other.address)
    pair.run(0.005)
    for each, got in zip(pair.ends, before, strict=True):
        assert len(each.got) - len(got) <= 2
        assert len(set(each.got)) == len(each.got)
    pair.run(21)
    assert sessions(pair) == [2, 2]
    assert not any(each.of(HandshakeFailed) for each in pair.ends)
    for each in pair.ends:
        assert_counted_once(each)


@BOTH
def test_a_new_address_is_followed_by_the_next_genuine_record(name):
    pair = connected()
    end = getattr(pair, name)
    other = pair.space if end is pair.ground else pair.ground
    end.address = STRANGER
    pair.run(1)
    assert other.of(PeerMoved) == [PeerMoved(STRANGER)]
    assert sessions(pair) == [1, 1]
    pair.run(1)
    # What was on its way to the old address is lost, not more.
    assert len(other.sealed) - len(end.got) <= 2 + 2 * pair.delay_ns // pair.slot_ns + 2


def test_an_overtaken_record_does_not_move_the_peer_back():
    pair = connected()
    old = pair.space.address
    held = pair.space.channel.seal(b"0", pair.now_ns)
    pair.space.address = STRANGER
    pair.run(0.1)
    pair.inject(held, old, GROUND_ADDRESS)
    pair.run(0.1)
    assert pair.ground.got[-1] != 0 and 0 in pair.ground.got
    assert pair.ground.of(PeerMoved) == [PeerMoved(STRANGER)]


def test_an_end_with_another_key_gets_no_answer_and_disturbs_nothing():
    pair = connected()
    wrong = ProtectedEnd(STRANGER_KEY, GROUND_KEY.identity, STRANGER, GROUND_ADDRESS)
    wrong.start(pair.now_ns)
    pair.unknown_senders.append(wrong)
    pair.run(10)
    knocks = sum(end is wrong for end, _ in pair.recorded)
    assert wrong.received == 0 and knocks > 5
    assert pair.ground.dropped == {"unauthenticated": knocks}
    assert_nothing_lost(pair)


@pytest.mark.parametrize("established", [False, True], ids=["at the start", "in a session"])
@BOTH
def test_who_knows_both_identities_but_no_key_begins_no_session(name, established):
    """The impostor's codes are right; its certificate is its own."""
    pair = connected() if established else ProtectedPair()
    victim = getattr(pair, name)
    true_end = pair.space if victim is pair.ground else pair.ground
    if not established:
        victim.start(0)
    impostor = ProtectedEnd(STRANGER_KEY, victim.key.identity, STRANGER, victim.address)
    impostor.start(pair.now_ns)
    pretend(impostor.channel, true_end.key, victim.key)
    pair.unknown_senders.append(impostor)
    before = len(victim.of(SessionBegun))
    pair.run(12)
    assert len(victim.of(SessionBegun)) == before
    assert not impostor.of(SessionBegun)
    # The one that is the client hears first that its peer is not the pinned one.
    refusals = victim.of(HandshakeFailed) + impostor.of(HandshakeFailed)
    assert "certificate verify failed" in {event.why for event in refusals}
    assert not victim.of(PeerMoved)
    if established:
        assert_nothing_lost(pair)
    true_end.start(pair.now_ns)
    pair.run(6)
    assert len(victim.of(SessionBegun)) == before + 1
    assert not impostor.of(SessionBegun)


def pretend(channel, true_key, victim_key):
    """Give a channel the codes and the role that the owner of `true_key` would have."""
    handshake = channel._handshake
    handshake._codec = SegmentCodec(true_key.identity, victim_key.identity)
    handshake._agreement.client = true_key.identity.digest < victim_key.identity.digest


def test_a_flood_of_knocks_costs_few_answers_and_no_memory():
    pair = connected()
    other = ProtectedEnd(SPACE_KEY, GROUND_KEY.identity, STRANGER, GROUND_ADDRESS)
    other.start(pair.now_ns)
    other.channel.handle_timeout(pair.now_ns)
    knock, _ = other.channel.poll_transmit()
    for _ in range(4):
        for port in range(1000):
            pair.inject(knock, ("203.0.113.9", port), GROUND_ADDRESS)
        pair.run(1)
    answers = sum(
        end is pair.ground and len(datagram) == SEGMENT_OVERHEAD_OCTETS
        for end, datagram in pair.recorded
    )
    # 20 at once and 20 a second; some belong to the true handshake.
    assert answers <= 20 + 4 * 20 + 10
    assert pair.ground.dropped["throttled"] >= 4000 - answers
    assert len(pair.ground.of(SessionBegun)) == 1
    assert_nothing_lost(pair)


def test_the_old_keys_are_forgotten_after_the_overlap():
    pair = connected()
    old = pair.space.channel.seal(b"0", pair.now_ns)
    late = pair.space.channel.seal(b"0", pair.now_ns)
    pair.space.start(pair.now_ns)
    pair.run(2.5)
    pair.inject(old, SPACE_ADDRESS, GROUND_ADDRESS)
    pair.run(0.1)
    assert 0 in pair.ground.got
    pair.run(OVERLAP_NS / S)
    pair.inject(late, SPACE_ADDRESS, GROUND_ADDRESS)
    pair.run(0.1)
    assert pair.ground.dropped == {"unknown_key": 1}


def test_late_datagrams_of_a_peer_that_restarted_do_not_disturb_its_new_attempt():
    pair = ProtectedPair()
    # Nothing of ground's flight arrives, so the first attempt stays open.
    pair.blocks = lambda end, datagram: end is pair.ground and len(datagram) > 600
    pair.start().run(0.5)
    late = [each for end, each in pair.recorded if end is pair.space and each[0] == HANDSHAKE]
    assert late
    pair.space.start(pair.now_ns)
    pair.run(0.5)
    for datagram in late:
        pair.inject(datagram, SPACE_ADDRESS, GROUND_ADDRESS)
    pair.run(0.1)
    assert pair.ground.dropped["stale"] >= len(late)
    assert [event.why for event in pair.ground.of(HandshakeFailed)] == ["the peer began anew"]
    pair.blocks = lambda end, datagram: False
    pair.run(2)
    assert sessions(pair) == [1, 1]


def test_a_silent_peer_is_asked_for_new_keys_after_two_seconds_unless_it_returns():
    pair = connected()
    pair.blocks = lambda end, datagram: True
    before = len(pair.recorded)
    pair.run(1.9)
    assert all(is_record(datagram) for _, datagram in pair.recorded[before:])
    pair.run(0.3)
    knocks = [datagram for _, datagram in pair.recorded[before:] if datagram[0] == KNOCK]
    assert len(knocks) >= 2
    # Until there are new keys, the old ones serve.
    assert all(end.channel.protected for end in pair.ends)
    # Records come before the next knock.
    pair.blocks = lambda end, datagram: not is_record(datagram)
    pair.run(0.1)
    pair.blocks = lambda end, datagram: False
    pair.run(3)
    assert sessions(pair) == [1, 1]


@pytest.mark.rule("7")
@pytest.mark.parametrize(
    ("datagram", "reason"),
    [
        (b"", "malformed"),
        (b"\x10" + bytes(60), "malformed"),
        (bytes([RECORD]) + bytes(24), "malformed"),
        (bytes([RECORD]) + bytes(25), "unknown_key"),
        (bytes([KNOCK]) + bytes(35), "malformed"),
        (bytes([KNOCK]) + bytes(36), "unauthenticated"),
        (bytes([KNOCK]) + bytes(1200), "malformed"),
    ],
)
def test_what_is_no_datagram_of_the_peer_is_dropped_by_its_reason(datagram, reason):
    pair = connected()
    before = pair.ground.channel.metrics.handshake_datagrams
    assert pair.ground.channel.handle_datagram(datagram, GROUND_ADDRESS, pair.now_ns) is None
    assert pair.ground.dropped == {reason: 1}
    assert pair.ground.channel.metrics.handshake_datagrams == before
    # A record under the right keys that is not genuine is another matter.
    sealed = pair.space.channel.seal(b"0", pair.now_ns)
    forged = sealed[:-1] + bytes([sealed[-1] ^ 1])
    pair.ground.channel.handle_datagram(forged, SPACE_ADDRESS, pair.now_ns)
    assert pair.ground.channel.metrics.dropped["unauthenticated"] == 1 + (
        reason == "unauthenticated"
    )


def test_frames_before_a_session_are_counted_as_unsent():
    pair = ProtectedPair().start()
    while not pair.ground.of(SessionBegun):
        pair.step()
    metrics = pair.ground.channel.metrics
    assert pair.ground.channel.protected and metrics.sessions == 1 and metrics.unsent > 3
    pair.run(1)
    assert metrics.unsent + metrics.sealed == pair.ground.frames_sent
    assert metrics.sealed == len(pair.ground.sealed)


def begun_at(pair, seconds):
    """When sessions begin at the ground, in ms."""
    found, seen = [], len(pair.ground.of(SessionBegun))
    for _ in range(round(seconds * S / pair.slot_ns)):
        pair.step()
        if len(pair.ground.of(SessionBegun)) > seen:
            seen += 1
            found.append(pair.now_ns // MS)
    return found


def test_keys_are_renewed_after_their_time_and_after_their_records():
    # A handshake takes some 80 ms on this path, and begins on time.
    times = begun_at(connected(rekey_ns=3 * S), 20)
    assert all(3000 <= b - a <= 3150 for a, b in pairwise(times)) and len(times) == 6
    times = begun_at(connected(rekey_records=200), 10)
    assert all(1000 <= b - a <= 1150 for a, b in pairwise(times)) and len(times) >= 8
    pair = connected(rekey_ns=3 * S).run(7)
    assert [event.renewed for event in pair.ground.of(SessionBegun)] == [False, True, True]


def test_keys_that_are_used_up_seal_no_more_and_new_ones_are_agreed(monkeypatch):
    pair = connected(rekey_records=100)
    # New ones are asked for long before, but no handshake gets through.
    pair.blocks = lambda end, datagram: datagram[0] != RECORD
    monkeypatch.setattr(datagrams, "MOST_RECORDS", 300)
    pair.run(300 * pair.slot_ns / S + 0.1)
    assert len(pair.ground.sealed) == 300 and not pair.ground.channel.protected
    metrics = pair.ground.channel.metrics
    assert metrics.sealed == 300 and metrics.unsent + 300 == pair.ground.frames_sent
    pair.blocks = lambda end, datagram: False
    pair.run(3)
    # It is a new session, not a renewed one: nothing could be sent in between.
    assert [event.renewed for event in pair.ground.of(SessionBegun)[:2]] == [False, False]
    assert pair.ground.channel.protected

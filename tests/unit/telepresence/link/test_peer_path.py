"""Whose frames are followed without protection; and the slots of a protected path."""

import pytest
from protected_pair import GROUND_ADDRESS, GROUND_KEY, SPACE_ADDRESS, SPACE_KEY

from pipelines.session.setup.setup_file import BUILT_IN
from telepresence.link.frame import FrameCodec
from telepresence.link.path.bundles import Bundling
from telepresence.link.peer_path import SILENCE_NS, STEP_NS, LookupSchedule, OpenPath, ProtectedPath
from telepresence.link.profile import UPLINK

DOWNLINK = BUILT_IN["spacejustin"].downlink
GOOD = FrameCodec(DOWNLINK).pack_idle(7, None)
HIT = bytes([GOOD[0] ^ 1]) + GOOD[1:]
PEER, OTHER = ("192.0.2.1", 27000), ("192.0.2.9", 4000)
SLOT_NS = 1_000_000
FRAME = bytes(32)


def test_who_sends_a_good_frame_first_is_the_peer():
    path = OpenPath(DOWNLINK, address=None, now_ns=0)
    assert path.seal(b"frame", 0) is None
    assert path.handle_datagram(HIT, OTHER, 1) is None
    assert path.handle_datagram(b"", OTHER, 1) is None
    assert path.handle_datagram(GOOD, PEER, 2) == GOOD
    assert path.seal(b"frame", 3) == (b"frame", PEER)
    metrics = path.report(4)
    assert (metrics.address, metrics.session_ns, metrics.unsent) == ("192.0.2.1:27000", 2, 1)
    assert metrics.dropped == {"unknown sender": 2}
    assert not metrics.protected
    # Another is followed only after a silence; a frame that the radio has hit is a sign of life.
    begun_ns = SILENCE_NS + 2
    assert path.handle_datagram(HIT, PEER, begun_ns) == HIT
    assert path.handle_datagram(GOOD, OTHER, begun_ns + SILENCE_NS - 1) is None
    assert path.handle_datagram(HIT, OTHER, begun_ns + SILENCE_NS) is None
    assert path.handle_datagram(GOOD, OTHER, begun_ns + SILENCE_NS) == GOOD
    metrics = path.report(begun_ns + SILENCE_NS)
    assert (metrics.address, metrics.address_changes) == ("192.0.2.9:4000", 1)
    assert metrics.dropped == {"unknown sender": 4}
    assert metrics.events[-1].what == "peer moved to 192.0.2.9:4000"


def test_a_given_address_is_never_left():
    path = OpenPath(DOWNLINK, address=PEER, now_ns=0)
    assert path.handle_datagram(GOOD, OTHER, 9 * SILENCE_NS) is None
    assert path.seal(b"frame", 1) == (b"frame", PEER)
    assert path.handle_datagram(GOOD, PEER, 10 * SILENCE_NS) == GOOD


class Pair:
    """Two paths that exchange a frame a slot; datagrams take no time.

    rest_ns: how much of a slot is left after its frame.
    """

    def __init__(self, *, rest_ns=900_000, **options):
        self.now_ns, self.rest_ns = 0, rest_ns
        self.space_at = SPACE_ADDRESS
        self.paths = {
            GROUND_ADDRESS: self.path(GROUND_KEY, SPACE_KEY, None, **options),
            SPACE_ADDRESS: self.path(SPACE_KEY, GROUND_KEY, GROUND_ADDRESS, **options),
        }
        self.ground, self.space = self.paths.values()
        self.frames = dict.fromkeys(self.paths.values(), 0)

    def path(self, key, peer, address, **options):
        return ProtectedPath(
            key,
            peer.identity,
            secret=key.identity.digest + bytes(12),
            address=address,
            now_ns=0,
            **options,
        )

    def deliver(self, sender, datagram, address):
        path = self.paths.get(address)
        if path is not None:
            frame = path.handle_datagram(datagram, sender, self.now_ns)
            while frame is not None:
                self.frames[path] += frame == FRAME
                frame = path.next_frame(self.now_ns)

    def slots(self, number, *, silent=()):
        """silent: paths whose radio sends no frame, because it has lost its signal."""
        for _ in range(number):
            self.now_ns += SLOT_NS
            for sender, path in list(self.paths.items()):
                sealed = None if path in silent else path.seal(FRAME, self.now_ns)
                if sealed is not None:
                    self.deliver(sender, *sealed)
                until_ns = self.now_ns + self.rest_ns
                spent_ns = 0
                while path.handle_rest(self.now_ns + spent_ns, until_ns):
                    spent_ns += STEP_NS
                while (found := path.poll_transmit()) is not None:
                    self.deliver(sender, *found)
        return self


def test_two_ends_agree_exchange_frames_and_say_what_happened():
    pair = Pair().slots(100)
    ground, space = pair.ground.report(pair.now_ns), pair.space.report(pair.now_ns)
    for mine, theirs, key in ((ground, space, SPACE_KEY), (space, ground, GROUND_KEY)):
        assert mine.protected
        assert mine.identity == str(key.identity)
        assert mine.sessions == 1
        assert mine.session_ns < 50 * SLOT_NS
        assert mine.taken == theirs.sent > 50
        assert mine.unsent + mine.sent == 100
        assert mine.address_changes == 0
    # The end that waits to be called was told by nobody where the other one is.
    assert ground.address == f"{SPACE_ADDRESS[0]}:{SPACE_ADDRESS[1]}"
    assert [event.what.partition(" ")[0] for event in ground.events] == ["peer", "session"]


def test_records_are_opened_at_once_and_handshakes_only_in_a_long_rest():
    pair = Pair().slots(100)
    before = pair.ground.report(pair.now_ns)
    sealed, _ = pair.space.seal(FRAME, pair.now_ns)
    knock = bytes([0x13]) + bytes(60)
    assert pair.ground.handle_datagram(knock, SPACE_ADDRESS, pair.now_ns) is None
    assert pair.ground.handle_datagram(sealed, SPACE_ADDRESS, pair.now_ns) == FRAME
    # It waits: not even its code was looked at.
    assert pair.ground.report(pair.now_ns).dropped == before.dropped
    assert not pair.ground.handle_rest(pair.now_ns, pair.now_ns + STEP_NS - 1)
    assert pair.ground.report(pair.now_ns).dropped == before.dropped
    assert pair.ground.handle_rest(pair.now_ns, pair.now_ns + STEP_NS)
    assert pair.ground.report(pair.now_ns).dropped == {"unauthenticated": 1}


def test_a_machine_without_any_rest_still_gets_a_session_and_new_keys():
    pair = Pair(rest_ns=STEP_NS // 2, rekey_ns=2_000 * SLOT_NS).slots(4_000)
    for path in (pair.ground, pair.space):
        assert path.report(pair.now_ns).sessions >= 2
    assert pair.frames[pair.ground] == pair.space.report(pair.now_ns).sent


def test_a_session_outlives_a_radio_without_a_signal():
    pair = Pair().slots(100)
    frames = dict(pair.frames)
    pair.slots(20_000, silent=(pair.ground, pair.space))
    # Signs of life are no frames, and few.
    assert pair.frames == frames
    before = pair.ground.report(pair.now_ns)
    assert 30 <= before.sent - frames[pair.space] <= 50
    pair.slots(100)
    for path in (pair.ground, pair.space):
        metrics = path.report(pair.now_ns)
        assert (metrics.sessions, metrics.dropped) == (1, {})
        assert pair.frames[path] == frames[path] + 100


@pytest.mark.parametrize("known", [True, False])
def test_frames_go_together_if_the_other_end_can_read_them(known):
    pair = Pair(bundling=Bundling(UPLINK, UPLINK, batch=4))
    if not known:
        pair.ground = pair.paths[GROUND_ADDRESS] = pair.path(GROUND_KEY, SPACE_KEY, None)
        pair.frames[pair.ground] = 0
    got = pair.slots(100).frames[pair.ground]
    taken = pair.ground.report(pair.now_ns).taken
    pair.slots(400)
    space = pair.space.report(pair.now_ns)
    assert pair.frames[pair.ground] - got == 400
    # Four reports of what arrived are among them.
    assert pair.ground.report(pair.now_ns).taken - taken == (104 if known else 400)
    assert (space.bundled, space.dropped) == (known, {})


def test_a_silent_peers_name_is_looked_up_ever_more_seldom():
    schedule = LookupSchedule()
    looked = [s for s in range(300) if schedule.poll(10 * SILENCE_NS, s * SILENCE_NS)]
    assert looked == [14, 18, 26, 42, 74, 138, 202, 266]
    assert [schedule.poll(300 * SILENCE_NS, s * SILENCE_NS) for s in (301, 304)] == [False, True]


def test_a_peer_that_is_found_at_another_address_is_asked_there():
    pair = Pair()
    space = pair.space = pair.paths[SPACE_ADDRESS] = pair.path(SPACE_KEY, GROUND_KEY, OTHER)
    pair.frames[space] = 0
    assert pair.slots(500).space.report(pair.now_ns).sessions == 0
    space.handle_address(GROUND_ADDRESS, pair.now_ns)
    assert pair.slots(2500).frames[space] > 1000
    assert space.report(pair.now_ns).events[0].what == "name looked up: 192.0.2.1:27000"

"""Frames of strangers in a live pair: delivered is exactly what the real peer sent.

A stranger knows the format, the configuration and old frames, but does not read what the two ends
send now.
"""

import struct
from random import Random

import pytest
from virtual_link import VirtualLink

from telepresence.link.flows import HapticReceived, Level, packet_flow
from telepresence.link.frame import FrameCodec, Pointers
from telepresence.link.gateway import Gateway
from telepresence.link.profile import DOWNLINK, UPLINK
from telepresence.link.radio import RadioPath

MS = 1_000_000
UP = [packet_flow("tc", Level.TMTC)]
DOWN = [packet_flow("tm", Level.TMTC)]
STRANGE = b"strange!!!!!"


class Path(RadioPath):
    """A radio path that can be closed, keeps what it carried, and lets frames be put in."""

    shut = False

    def __init__(self, delay_ns, loss=0.0):
        super().__init__(delay_ns=delay_ns, loss=loss)
        self.sent = []

    def handle_frame(self, frame, now_ns):
        if not self.shut:
            self.sent.append(frame)
            super().handle_frame(frame, now_ns)


class Pair:
    """Samples and packets both ways, each of them unlike all others."""

    def __init__(self, *, delay_ms=12, seed=1):
        self.paths = {"ground": Path(delay_ms * MS), "space": Path(delay_ms * MS)}
        self.seed = seed
        self.link = VirtualLink(
            uplink_flows=UP,
            downlink_flows=DOWN,
            up=self.paths["ground"],
            down=self.paths["space"],
            seed=seed,
        )
        self.lives = 0
        #: By the receiving side: what was sent to it, and what it delivered, each with its instant.
        self.sent = {"ground": [], "space": []}
        self.got = {"ground": [], "space": []}

    def run(self, slots, inject=None):
        """inject(slot): pairs of the side that receives a strange frame, and the frame."""
        for slot in range(slots):
            now_ns = self.link.now_ns
            for side, flow, other in (("ground", "tc", "space"), ("space", "tm", "ground")):
                gateway = getattr(self.link, side)
                sample = struct.pack(">QI", now_ns, self.lives)
                gateway.handle_haptic(sample, now_ns)
                self.sent[other].append((now_ns, sample))
                if slot % 7 == 0:
                    packet = struct.pack(">QI", now_ns, self.lives) + b"packet"
                    gateway.handle_datagram(flow, packet, now_ns)
                    self.sent[other].append((now_ns, packet))
            for side, frame in inject(slot) if inject else ():
                gateway = getattr(self.link, side)
                gateway.handle_radio(frame, now_ns)
                while (event := gateway.next_event()) is not None:
                    self.take(gateway, event)
            for gateway, event in self.link.step():
                self.take(gateway, event)

    def take(self, gateway, event):
        data = event.sample if isinstance(event, HapticReceived) else event.data
        side = "ground" if gateway is self.link.ground else "space"
        self.got[side].append((event.now_ns, data))

    def restart(self, side):
        self.lives += 1
        new = make_gateway(side, 0x7000 + self.lives, self.paths[side], self.link.now_ns)
        setattr(self.link, side, new)

    def shut(self, *sides):
        for side, path in self.paths.items():
            path.shut = side in sides

    def lost(self, side, since_ns, until_ns):
        """What was sent to `side` in this time, and not delivered."""
        got = {data for _, data in self.got[side]}
        sent = self.sent[side]
        return [at for at, data in sent if since_ns <= at < until_ns and data not in got]

    def check_genuine(self, side):
        """Nothing strange and nothing twice has come out at `side`."""
        got = [data for _, data in self.got[side]]
        assert len(got) == len(set(got))
        assert set(got) <= {data for _, data in self.sent[side]}


def make_gateway(side, life, path=None, now_ns=0):
    transmit, receive = (UPLINK, DOWNLINK) if side == "ground" else (DOWNLINK, UPLINK)
    return Gateway(
        transmit=transmit,
        transmit_flows=UP if side == "ground" else DOWN,
        receive=receive,
        receive_flows=DOWN if side == "ground" else UP,
        radio=path,
        master=side == "ground",
        life=life,
        now_ns=now_ns,
        secret=life,
    )


def frames_of_a_stranger(side, life, count, *, first_count=None, seed=0):
    """What a gateway that hears nobody sends to `side`, with samples and packets."""
    gateway = make_gateway("space" if side == "ground" else "ground", life)
    if first_count is not None:
        gateway.sender._count = first_count
    frames = []
    for slot in range(count):
        gateway.handle_haptic(STRANGE, slot * MS)
        gateway.handle_datagram("tm" if side == "ground" else "tc", STRANGE, slot * MS)
        gateway.handle_slot(slot * MS)
        frames.append(gateway.poll_transmit(slot * MS))
    return frames


class Stranger:
    """Puts in frames of each kind at random instants."""

    def __init__(self, pair, kind, seed):
        self.pair, self.kind = pair, kind
        self.random = Random(f"{kind} {seed}")
        self.waiting = {"ground": [], "space": []}
        self.injected = 0

    def __call__(self, slot):
        for side, waiting in self.waiting.items():
            if not waiting and self.random.random() < 0.05:
                waiting += self.frames(side)
            # At the rate of the link, or all at once.
            for _ in range(len(waiting) if self.random.random() < 0.02 else 1):
                if waiting:
                    self.injected += 1
                    yield side, waiting.pop(0)

    def frames(self, side):
        random = self.random
        profile = DOWNLINK if side == "ground" else UPLINK
        if self.kind == "blind restart":
            return frames_of_a_stranger(side, random.randrange(1, 0xFFFF), 2, first_count=0)
        if self.kind == "consistent peer":
            return frames_of_a_stranger(side, random.randrange(1, 0xFFFF), 62)
        # Without those under way: only who reads them now knows them.
        recorded = self.pair.paths["space" if side == "ground" else "ground"].sent[:-50]
        if self.kind == "recording" and len(recorded) > 62:
            begin = random.randrange(len(recorded) - 62)
            return recorded[begin : begin + 62]
        if self.kind == "stale frame" and recorded:
            return [random.choice(recorded)]
        if self.kind == "stray frame":
            codec = FrameCodec(profile)
            zone = random.randbytes(profile.packet_zone_octets)
            pointer = random.choice((0, Pointers(profile).supervision, Pointers(profile).idle))
            count = random.choice((0, 1, random.randrange(1 << 24)))
            return [codec.pack(count, STRANGE, pointer, zone)]
        return []


KINDS = ["blind restart", "consistent peer", "recording", "stale frame", "stray frame"]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("kind", KINDS)
def test_strange_frames_in_a_live_pair_change_nothing(kind, seed):
    pair = Pair(seed=seed)
    pair.run(300)
    stranger = Stranger(pair, kind, seed)
    before = {side: getattr(pair.link, side).report(pair.link.now_ns) for side in pair.got}
    pair.run(5000, stranger)
    assert stranger.injected > 100
    for side in pair.got:
        pair.check_genuine(side)
        assert not pair.lost(side, 300 * MS, 5200 * MS)
        after = getattr(pair.link, side).report(pair.link.now_ns)
        assert after.receive.restarts == before[side].receive.restarts
        assert after.receive.frames_lost == 0
        assert after.supervision.counts["peer_restarts"] == 0
        assert after.supervision.state == "connected"
        # What strangers make this end send stays below 5 % of its slots.
        assert after.supervision.counts["messages_sent"] <= 5000 // 20 + 50


def test_late_copies_of_all_frames_change_nothing():
    """As by a second route that is 30 ms longer, also of frames that the first one loses."""
    pair = Pair()
    for side in ("ground", "space"):
        getattr(pair.link, side).radio = pair.paths[side] = Path(12 * MS, loss=0.1)

    def copies(slot):
        for side, path in (("ground", pair.paths["space"]), ("space", pair.paths["ground"])):
            if len(path.sent) > 42:
                yield side, path.sent[-42]

    pair.run(10_000, copies)
    for side in pair.got:
        pair.check_genuine(side)
        assert len(pair.got[side]) > 0.85 * len(pair.sent[side])
        report = getattr(pair.link, side).report(pair.link.now_ns)
        assert report.receive.restarts == report.supervision.counts["peer_restarts"] == 0
        assert report.supervision.counts["signals_lost"] == 0
        assert report.receive.frames_received > 0.88 * 10_000


@pytest.mark.parametrize("kind", KINDS)
def test_strange_frames_are_no_signal(kind):
    """The link is dead both ways, and its peers have not restarted."""
    pair = Pair()
    pair.run(300)
    pair.shut("ground", "space")
    pair.run(100)
    ends = (pair.link.ground, pair.link.space)
    assert not any(end.supervisor.signal for end in ends)
    for _ in range(40):
        pair.run(45, Stranger(pair, kind, 1))
        assert not any(end.supervisor.signal for end in ends)
    pair.shut()
    back_ns = pair.link.now_ns
    pair.run(200)
    for side in pair.got:
        pair.check_genuine(side)
        assert not pair.lost(side, back_ns, back_ns + 150 * MS)


@pytest.mark.parametrize("side", ["ground", "space"])
@pytest.mark.parametrize("strange", [False, True])
def test_a_real_restart_takes_a_round_trip_more(side, strange):
    """Each end delivers when its own number has come back, also among strange frames."""
    pair = Pair()
    pair.run(300)
    pair.restart(side)
    begun_ns = pair.link.now_ns
    pair.run(1000, Stranger(pair, "stray frame", 1) if strange else None)
    first = {
        name: next(at for at, data in got if struct.unpack_from(">QI", data)[0] >= begun_ns)
        for name, got in pair.got.items()
    }
    other = "space" if side == "ground" else "ground"
    # The new life's first message, the answer, and at the peer the answer to that.
    assert (first[side] - begun_ns) // MS <= 2 * 12 + 15
    assert (first[other] - begun_ns) // MS <= 3 * 12 + 25
    for name in pair.got:
        pair.check_genuine(name)
        # What waited for the former life was dropped.
        assert not pair.lost(name, first[other] + 5 * MS, begun_ns + 900 * MS)


def test_a_sender_that_restarts_one_way_is_followed_after_a_silence():
    """It hears nobody and cannot answer, so the old stream must have been silent for 2 s."""
    pair = Pair()
    pair.run(300)
    pair.shut("space")
    pair.run(500)
    pair.restart("ground")
    begun_ns = pair.link.now_ns
    pair.run(3000)
    got = [at for at, data in pair.got["space"] if struct.unpack_from(">QI", data)[1] == 1]
    assert 2000 <= (got[0] - begun_ns) // MS <= 2000 + 12 + 25
    # Nothing old came out then, and from then on nothing is missing.
    assert not pair.lost("space", got[0], begun_ns + 2900 * MS)
    first = next(data for _, data in pair.got["space"] if struct.unpack_from(">QI", data)[1] == 1)
    assert got[0] - struct.unpack_from(">Q", first)[0] == 12 * MS
    pair.check_genuine("space")
    # It proves itself as soon as it hears.
    pair.shut()
    pair.run(200)
    for end in (pair.link.ground, pair.link.space):
        assert end.supervisor.state.name == "CONNECTED"


def test_a_peer_whose_delay_falls_is_followed_again_after_a_round_trip():
    """Its frames come before their time, as those of a stranger that guesses counts would."""
    pair = Pair(delay_ms=400)
    pair.run(3000)
    pair.shut("ground", "space")
    pair.run(500)
    for side in ("ground", "space"):
        getattr(pair.link, side).radio = Path(12 * MS)
    changed_ns = pair.link.now_ns
    pair.run(2000)
    for side in pair.got:
        pair.check_genuine(side)
        assert not pair.lost(side, changed_ns + 100 * MS, changed_ns + 1900 * MS)
        report = getattr(pair.link, side).report(pair.link.now_ns)
        assert report.receive.restarts == report.supervision.counts["peer_restarts"] == 0

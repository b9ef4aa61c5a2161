"""Two gateways with a radio between them: what they deliver, and what they take for a signal.

An intruder knows the format, the configuration and old frames, but does not read what the ends
send now.
"""

import struct
from collections import deque
from itertools import pairwise
from random import Random

import pytest
from virtual_link import VirtualLink

from telepresence.link.flows import HapticReceived, Level, packet_flow, video_flow, voice_flow
from telepresence.link.frame import FrameCodec, Pointers
from telepresence.link.gateway import (
    FREED_STEP_BPS,
    REPEAT_NS,
    REPORT_NS,
    Backlog,
    BacklogReporter,
    Gateway,
)
from telepresence.link.header_compression import FIRST_WHOLE
from telepresence.link.path.following import ALL, PARTS, Allowed
from telepresence.link.profile import DOWNLINK, UPLINK
from telepresence.link.radio import RadioPath

MS = 1_000_000
DELAY_MS = 12
SIDES = ("ground", "space")
OTHER = {"ground": "space", "space": "ground"}
FLOWS = [
    packet_flow("tm", Level.TMTC),
    voice_flow("voice"),
    video_flow("video"),
    packet_flow("files", Level.MAINTENANCE),
]
TRAFFIC = ("samples", "tm", "voice", "video", "files")
STRANGE = b"strange!!!!!"


def make_gateway(side, boot_id, radio=None, now_ns=0):
    ways = (UPLINK, DOWNLINK)
    transmit, receive = ways if side == "ground" else ways[::-1]
    return Gateway(
        transmit=transmit,
        transmit_flows=FLOWS,
        receive=receive,
        receive_flows=FLOWS,
        radio=radio,
        master=side == "ground",
        boot_id=boot_id,
        now_ns=now_ns,
        secret=boot_id,
    )


class Path(RadioPath):
    """A radio path that can be closed, keeps what it carried, and by chance loses frames.

    trouble: the share of frames that come twice, after the next one, or with flipped bits.
    """

    def __init__(self, delay_ms, random):
        super().__init__(delay_ns=delay_ms * MS)
        self.random, self.loss, self.trouble, self.shut = random, 0.0, 0.0, False
        self.sent, self.held = [], []

    def handle_frame(self, frame, now_ns):
        if self.shut or self.random.random() < self.loss:
            return
        frames, self.held = [frame, *self.held], []
        if self.random.random() < self.trouble:
            what = self.random.randrange(3)
            if what == 0:
                frames.append(frame)
            elif what == 1:
                frames, self.held = frames[1:], [frame]
            else:
                wrong = int.from_bytes(frame, "big")
                for bit in self.random.sample(range(8 * len(frame)), self.random.randint(1, 3)):
                    wrong ^= 1 << bit
                frames[0] = wrong.to_bytes(len(frame), "big")
        for one in frames:
            self.sent.append(one)
            super().handle_frame(one, now_ns)


class Session:
    """Samples and packets both ways, each unlike all others, and more than the uplink carries.

    What comes out must have been put in at the other side, whole, once and in the order of its
    flow. By the receiving side, `sent`: when, flow and data; `got`: when it came and was put in,
    flow and data. traffic: what is put in, of TRAFFIC.
    """

    def __init__(self, *, delay_ms=DELAY_MS, seed=1, traffic=TRAFFIC):
        self.random = Random(seed)
        self.paths = {side: Path(delay_ms, self.random) for side in SIDES}
        self.link = VirtualLink(
            uplink_flows=FLOWS,
            downlink_flows=FLOWS,
            up=self.paths["ground"],
            down=self.paths["space"],
            seed=seed,
        )
        self.traffic, self.lives, self.slot = traffic, 0, 0
        self.sources = {}
        for side in SIDES:
            self.new_source(side)
        self.sent, self.got = {side: [] for side in SIDES}, {side: [] for side in SIDES}
        self.waiting = {(side, flow): deque() for side in SIDES for flow in TRAFFIC}

    def end(self, side):
        return getattr(self.link, side)

    @property
    def ends(self):
        return self.link.ground, self.link.space

    @property
    def states(self):
        return [end.supervisor.state.name for end in self.ends]

    def reports(self):
        return [end.report(self.link.now_ns) for end in self.ends]

    def new_source(self, side):
        """Voice and video with other numbers, as of a restarted program."""
        draw = self.random.getrandbits
        self.sources[side] = {flow: [draw(16), draw(32), draw(32)] for flow in ("voice", "video")}

    def restart(self, side):
        self.lives += 1
        boot_id = 0x7000 + self.lives
        setattr(self.link, side, make_gateway(side, boot_id, self.paths[side], self.link.now_ns))

    def shut(self, *sides):
        """Close the paths of what these sides send, and open the others."""
        for side, path in self.paths.items():
            path.shut = side in sides

    def put(self, side, flow, data):
        end, now_ns = self.end(side), self.link.now_ns
        if flow == "samples":
            end.handle_haptic(data, now_ns)
        else:
            end.handle_datagram(flow, data, now_ns)
        self.sent[OTHER[side]].append((now_ns, flow, data))
        self.waiting[OTHER[side], flow].append((data, now_ns))

    def put_rtp(self, side, flow, timestamp, payload, marker=0):
        source = self.sources[side][flow]
        source[0] += 1
        fields = marker << 7 | 96, source[0] & 0xFFFF, source[1] + timestamp & 0xFFFFFFFF, source[2]
        self.put(side, flow, struct.pack(">BBHII", 0x80, *fields) + payload)

    def put_all(self, side, slot):
        stamp = struct.pack(">QI", self.link.now_ns, self.lives)
        if "samples" in self.traffic:
            self.put(side, "samples", stamp)
        if "tm" in self.traffic and slot % 50 == 0:
            self.put(side, "tm", stamp)
        if "files" in self.traffic and slot % 50 == 0:
            self.put(side, "files", stamp + bytes(300))
        if "voice" in self.traffic and slot % 20 == 0:
            self.put_rtp(side, "voice", slot // 20 * 960, stamp + bytes(8))
        if "video" in self.traffic and slot % 33 == 0:
            parts = 1 if side == "ground" else self.random.choice((2, 3))
            for part in range(parts):
                payload = stamp + bytes([part]) + bytes(300)
                self.put_rtp(side, "video", slot * 90, payload, marker=part == parts - 1)

    def run(self, slots, inject=lambda slot: ()):
        """inject(slot): pairs of the side that receives a strange frame, and the frame."""
        for slot in range(slots):
            for side in SIDES:
                self.put_all(side, self.slot)
            for side, frame in inject(slot):
                self.end(side).handle_radio(frame, self.link.now_ns)
                for event in iter(self.end(side).next_event, None):
                    self.take(self.end(side), event)
            for gateway, event in self.link.step():
                self.take(gateway, event)
            self.slot += 1
        return self

    def take(self, gateway, event):
        side = "ground" if gateway is self.link.ground else "space"
        haptic = isinstance(event, HapticReceived)
        flow, data = ("samples", event.sample) if haptic else (event.flow.name, event.data)
        queued = self.waiting[side, flow]
        while (one := queued.popleft())[0] != data:
            pass
        self.got[side].append((event.now_ns, one[1], flow, data))

    def came(self, side, *flows, since_ns=0):
        """When packets of these flows came out at `side`, and when they were put in."""
        got = self.got[side]
        return [(at, put) for at, put, flow, _ in got if flow in flows and put >= since_ns]

    def lost(self, side, since_ns, until_ns, flows=("samples", "tm")):
        """What was sent to `side` in this time, and not delivered."""
        got = {data for _, _, _, data in self.got[side]}
        sent = [(at, data) for at, flow, data in self.sent[side] if flow in flows]
        return [at for at, data in sent if since_ns <= at < until_ns and data not in got]


def connected(slots=1000, **options):
    one = Session(**options).run(slots)
    assert one.states == ["CONNECTED"] * 2
    return one


def test_a_packet_comes_out_after_the_delay_both_ways():
    one = Session(traffic=()).run(100)
    for side in SIDES:
        one.put(side, "tm", side.encode())
    one.run(50)
    assert [one.came(side, "tm") for side in SIDES] == [[(112 * MS, 100 * MS)]] * 2
    report = one.link.ground.report(one.link.now_ns)
    assert report.transmit.octets["tmtc"] == 6
    assert report.radio.frames_under_way == 12
    assert report.supervision.state == "connected"


def test_poll_timeout_is_when_the_next_frame_arrives():
    ground = make_gateway("ground", 1, RadioPath(delay_ns=3 * MS))
    assert ground.poll_timeout() is None
    ground.handle_slot(MS)
    ground.handle_slot(2 * MS)
    assert ground.poll_timeout() == 4 * MS
    assert ground.poll_transmit(4 * MS - 1) is None
    assert ground.poll_transmit(4 * MS) is not None
    assert ground.poll_timeout() == 5 * MS


@pytest.mark.parametrize(("blackout_ms", "phase"), [(100, 0), (1_000, 13), (4_000, 0)])
def test_haptics_return_with_the_first_frame_after_a_blackout_and_nothing_stale(blackout_ms, phase):
    one = connected(1000 + phase)
    began_ns = one.link.now_ns
    one.shut(*SIDES)
    one.run(DELAY_MS + 50)
    # The last frame was sent a slot before the paths were closed.
    assert not any(end.supervisor.signal for end in one.ends)
    one.run(blackout_ms - DELAY_MS - 50)
    back_ns = one.link.now_ns
    first_ns = back_ns + DELAY_MS * MS
    one.shut()
    one.got = {side: [] for side in SIDES}
    one.run(300)
    for side, report in zip(SIDES, one.reports(), strict=True):
        assert report.supervision.contacts[-1].acquired_ns == first_ns
        assert one.came(side, "samples")[0] == (first_ns, back_ns)
        packets = one.came(side, "tm", "voice", "video")
        assert packets[0][0] - first_ns <= 100 * MS
        assert min(put_ns for _, put_ns in packets) > began_ns
        # Little may wait, and a packet that has begun is completed.
        early = [at - put for at, put in packets if at < first_ns + 20 * MS]
        assert max(early, default=0) <= (DELAY_MS + 50 + 40) * MS
    assert one.states == ["CONNECTED"] * 2


def test_a_loss_of_signal_flushes_waiting_packets():
    one = connected(1025)
    sender = one.link.ground.sender
    assert sum(sender.waiting_octets(level) for level in Level)
    one.shut("space")
    one.traffic = ("samples",)
    while one.link.ground.supervisor.signal:
        waiting = sum(sender.waiting_octets(level) for level in Level)
        one.run(1)
    assert waiting and not sum(sender.waiting_octets(level) for level in Level)
    drops = [queue.drops for queue in sender.report(one.link.now_ns).queue.values()]
    assert sum(drop["signal_lost"] for drop in drops)


@pytest.mark.parametrize("side", SIDES)
def test_a_single_working_direction_keeps_carrying(side):
    """side: what it sends arrives."""
    one, far = connected(), OTHER[side]
    since_ns = one.link.now_ns
    before = one.end(side).report(since_ns).supervision.counts["messages_sent"]
    one.shut(far)
    one.run(4_000)
    states = [one.end(each).supervisor.state.name for each in (side, far)]
    assert states == ["SEARCH", "CONFIGURE"]
    assert "does not hear" in one.end(far).supervisor.why and not one.end(far).supervisor.peer_hears
    # Messages to a peer that may not hear are limited, because media share the capacity.
    counts = one.end(side).report(one.link.now_ns).supervision.counts
    assert counts["messages_sent"] - before <= 4 * 20 + 100
    until_ns = one.link.now_ns - 100 * MS
    assert not one.lost(far, since_ns + 50 * MS, until_ns)
    media = one.came(far, "voice", "video", since_ns=since_ns)
    assert len(media) >= 0.97 * (4_000 // 20 + 4_000 // 33)
    assert max(at - put for at, put in media) <= 200 * MS
    one.shut()
    one.run(100)
    assert one.states == ["CONNECTED"] * 2
    # What the other side put in meanwhile was not kept for later.
    back_ns = one.link.now_ns - 300 * MS
    assert all(put > back_ns for _, put in one.came(side, "tm", since_ns=since_ns + 50 * MS))


def test_a_reset_of_the_applications_forgets_what_the_peer_sent_before():
    """Nothing comes for long: then each flow begins with whole headers again."""
    one = connected(traffic=("samples", "voice"))
    one.traffic = ()
    reset = []
    while not reset:
        one.run(50)
        assert one.slot < 5000
        counts = [report.supervision.counts for report in one.reports()]
        resets = [each["resets_idle"] + each["resets_broken"] for each in counts]
        reset = [end for end, number in zip(one.ends, resets, strict=True) if number]
    before = [end.sender.report(one.link.now_ns).headers["voice"] for end in reset]
    one.traffic = ("voice",)
    one.run(300)
    for end, was in zip(reset, before, strict=True):
        now = end.sender.report(one.link.now_ns).headers["voice"]
        assert now["whole"] - was["whole"] == FIRST_WHOLE < now["packets"] - was["packets"]


def frames_of_a_stranger(side, boot_id, count):
    """What a gateway that hears nobody sends to `side`, with samples and packets."""
    gateway, frames = make_gateway(OTHER[side], boot_id), []
    for slot in range(count):
        gateway.handle_haptic(STRANGE, slot * MS)
        gateway.handle_datagram("tm", STRANGE, slot * MS)
        gateway.handle_slot(slot * MS)
        frames.append(gateway.poll_transmit(slot * MS))
    return frames


class Stranger:
    """Puts in frames of each kind at random instants."""

    def __init__(self, session, kind, seed=1):
        self.session, self.kind = session, kind
        self.random = Random(f"{kind} {seed}")
        self.waiting = {side: [] for side in SIDES}
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
        if self.kind == "consistent peer":
            return frames_of_a_stranger(side, random.randrange(1, 0xFFFF), 62)
        # Without those under way: only who reads them now knows them.
        recorded = self.session.paths[OTHER[side]].sent[:-50]
        if self.kind == "recording" and len(recorded) > 62:
            begin = random.randrange(len(recorded) - 62)
            return recorded[begin : begin + 62]
        if self.kind == "stale frame" and recorded:
            return [random.choice(recorded)]
        if self.kind == "stray frame":
            profile = DOWNLINK if side == "ground" else UPLINK
            zone = random.randbytes(profile.packet_zone_octets)
            pointer = random.choice((0, Pointers(profile).supervision, Pointers(profile).idle))
            count = random.choice((0, 1, random.randrange(1 << 24)))
            return [FrameCodec(profile).pack(count, STRANGE, pointer, zone)]
        return []


KINDS = pytest.mark.parametrize(
    "kind", ["consistent peer", "recording", "stale frame", "stray frame"]
)


@KINDS
@pytest.mark.parametrize("seed", range(2))
def test_strange_frames_in_a_live_pair_change_nothing(kind, seed):
    one = Session(seed=seed).run(300)
    unknown = Stranger(one, kind, seed)
    before = one.reports()
    one.run(3000, unknown)
    assert unknown.injected > 60
    for side, was, report in zip(SIDES, before, one.reports(), strict=True):
        assert not one.lost(side, 300 * MS, 3200 * MS)
        assert report.receive.restarts == was.receive.restarts
        assert report.receive.frames_lost == report.supervision.counts["peer_restarts"] == 0
        assert report.supervision.state == "connected"
        # What unknown senders make this end send stays below 5 % of its slots.
        assert report.supervision.counts["messages_sent"] <= 3000 // 20 + 50


@pytest.mark.parametrize("side", SIDES)
@pytest.mark.parametrize("strange", [False, True])
def test_a_real_restart_takes_a_round_trip_more(side, strange):
    """Each end delivers when its own number has come back, also among strange frames."""
    one = Session().run(300)
    one.restart(side)
    begun_ns, far = one.link.now_ns, OTHER[side]
    one.run(1000, Stranger(one, "stray frame") if strange else lambda slot: ())
    counts = [report.supervision.counts["peer_restarts"] for report in one.reports()]
    assert dict(zip(SIDES, counts, strict=True)) == {side: 0, far: 1}
    first = {each: one.came(each, "samples", since_ns=begun_ns)[0][0] for each in SIDES}
    # The new start's first message, the answer, and at the peer the answer to that.
    assert (first[side] - begun_ns) // MS <= 2 * DELAY_MS + 15
    assert (first[far] - begun_ns) // MS <= 3 * DELAY_MS + 25
    for each in SIDES:
        # What waited for the former life was dropped.
        assert not one.lost(each, first[far] + 5 * MS, begun_ns + 900 * MS)
        # The new start understands voice without waiting for the next context, a second later.
        since_ns = begun_ns + 120 * MS
        assert not one.lost(each, since_ns, begun_ns + 900 * MS, flows=("voice",))


def test_a_peer_whose_delay_falls_is_followed_again_after_a_round_trip():
    """Its frames come before their time, as those of an intruder that guesses counts would."""
    one = Session(delay_ms=400).run(3000)
    one.shut(*SIDES)
    one.run(500)
    for side in SIDES:
        one.end(side).radio = Path(DELAY_MS, one.random)
    changed_ns = one.link.now_ns
    one.run(2000)
    for side, report in zip(SIDES, one.reports(), strict=True):
        assert not one.lost(side, changed_ns + 100 * MS, changed_ns + 1900 * MS)
        assert report.receive.restarts == report.supervision.counts["peer_restarts"] == 0


@pytest.mark.parametrize("seed", range(4))
def test_losses_and_restarts_never_corrupt_a_packet(seed):
    traffic = ("voice", "video") if seed % 2 else TRAFFIC
    one = Session(delay_ms=[0, 12, 120, 350][seed], seed=seed, traffic=traffic).run(3000)
    random = Random(seed)
    before = one.reports()
    one.run(2000)
    for was, report in zip(before, one.reports(), strict=True):
        assert "no_context" not in report.receive.packets_dropped
        for flow, headers in report.transmit.headers.items():
            assert headers["whole"] - was.transmit.headers[flow]["whole"] <= 10
    for _ in range(30):
        for path in one.paths.values():
            path.loss = random.choice((0, 0, 0, 0.02, 0.3, 1))
            path.trouble = random.choice((0, 0, 0.02, 0.5))
        side, what = random.choice(SIDES), random.randrange(6)
        if what == 0:
            one.restart(side)
        if what < 2:
            one.new_source(side)
        one.run(random.choice((30, 200, 700, 1500)))
    assert sum(len(got) for got in one.got.values()) > 600


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


@pytest.fixture(scope="module")
def reports():
    """Run some seconds with video and missing samples: (instant, exact state, report)."""
    link = VirtualLink(
        uplink_flows=[packet_flow("picture", Level.VIDEO)],
        downlink_flows=[packet_flow("command", Level.TMTC)],
    )
    chance = Random(1)
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


def test_the_first_slot_and_each_change_are_reported_at_most_every_four_milliseconds(reports):
    assert reports[0][2] == rounded(reports[0][1])
    messages = [(now_ns, true, message) for now_ns, true, message in reports if message is not None]
    assert len(messages) > 200
    distances = set()
    for (earlier_ns, _, earlier), (later_ns, _, later) in pairwise(messages):
        distances.add(later_ns - earlier_ns)
        assert later != earlier or later_ns - earlier_ns == REPEAT_NS
    # Sometimes a change is reported at the earliest allowed instant.
    assert min(distances) == 4 * MS == REPORT_NS
    # Freed capacity is rounded down; some exact values are not round.
    assert len({message.freed_bps for *_, message in messages}) > 10
    for _, true, message in messages:
        assert message.freed_bps % 1000 == 0 <= true.freed_bps - message.freed_bps < 1000
        assert message == rounded(true)
    assert any(true.freed_bps % 1000 for _, true, _ in messages)


def test_without_a_change_the_state_is_repeated_for_a_process_that_was_started_since(reports):
    # In the last seconds every slot has a sample. Once the window holds no other, nothing changes.
    last = rounded(reports[-1][1])
    quiet_ns = next(ns for ns, true, _ in reports[::-1] if rounded(true) != last) + 4 * MS
    again = [(ns, message) for ns, _, message in reports if message and ns > quiet_ns]
    assert len(again) >= 2
    assert all(message == last for _, message in again)
    assert all(b[0] - a[0] == REPEAT_NS for a, b in pairwise(again))


def test_a_path_that_carries_less_holds_repair_and_files_and_tells_the_senders_of_video():
    link = VirtualLink(
        uplink_flows=[packet_flow("file", Level.MAINTENANCE), packet_flow("command", Level.TMTC)],
        downlink_flows=[packet_flow("state", Level.TMTC)],
    )
    ground, got = link.ground, []
    reporter = BacklogReporter(ground)
    assert reporter.poll_transmit(link.now_ns).cap_parts == PARTS
    ground.handle_path(Allowed("no video", idle=False, cap_parts=0, leave_out=2))
    for flow in ("file", "command"):
        ground.handle_datagram(flow, bytes(20), link.now_ns)
    for _ in range(100):
        got += [event.flow.name for _, event in link.step() if hasattr(event, "flow")]
    report = reporter.poll_transmit(link.now_ns)
    assert (report.cap_parts, report.leave_out, report.maintenance_octets) == (0, 2, 20)
    assert got == ["command"] and ground.repair.saving
    ground.handle_path(ALL)
    for _ in range(100):
        got += [event.flow.name for _, event in link.step() if hasattr(event, "flow")]
    assert got == ["command", "file"] and not ground.repair.saving


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

"""What goes over a path follows what the path carries, on virtual time."""

from random import Random

import pytest
from common import first_seed, repeats
from mutated_octets import mutate
from protected_pair import GROUND_ADDRESS, GROUND_KEY, SPACE_ADDRESS, SPACE_KEY

from telepresence.link.frame import FrameCodec
from telepresence.link.path.bundles import Bundling
from telepresence.link.path.following import (
    ALL,
    PARTS,
    Arrivals,
    PathFollower,
    PathNeeds,
    PathReport,
)
from telepresence.link.peer_path import ProtectedPath
from telepresence.link.profile import DOWNLINK
from telepresence.link.protection.datagrams import REPORT
from telepresence.link.radio.network import Network, NetworkPath

MS = 1_000_000
VIDEO_BPS = 1_500_000
NEEDS = PathNeeds(VIDEO_BPS, PARTS // 3)
STATES = ["all", "no idle", "lower caps", "fewer pictures", "no video"]


class Session:
    """Space sends samples, and pictures that fill what is allowed, over a path to the ground.

    states: (ms, state) at each change. delays_ms: by the instant of arrival, the delay of a frame.
    """

    def __init__(self, conditions, *, compact=True, peer_follows=True, batch=1):
        self.now_ns, self.bits = 0, 0.0
        bundling = Bundling(DOWNLINK, DOWNLINK, batch, compact)
        more = {"secret": bytes(32), "now_ns": 0}
        self.space = ProtectedPath(
            SPACE_KEY,
            GROUND_KEY.identity,
            address=GROUND_ADDRESS,
            bundling=bundling,
            needs=NEEDS,
            **more,
        )
        self.ground = ProtectedPath(
            GROUND_KEY,
            SPACE_KEY.identity,
            address=None,
            bundling=bundling if peer_follows else None,
            **more,
        )
        self.codec = FrameCodec(DOWNLINK)
        self.out = NetworkPath(conditions)
        self.back = NetworkPath(Network(delay_ms=10))
        self.count, self.states, self.delays_ms = 0, [(0, "all")], {}

    def run(self, seconds):
        for _ in range(round(seconds * 1000)):
            self._slot()
        return self

    def _frame(self):
        allowed = self.space.allowed
        rate = 2 / 3 if allowed.leave_out else 1.0
        if self.now_ns // MS % 33 == 0:
            self.bits += VIDEO_BPS * 0.033 * allowed.cap_parts / PARTS * rate
        zone, sample = b"", bytes(12)
        if self.bits > 0:
            zone, self.bits = bytes([1]) * 478, self.bits - 478 * 8
        self.count += 1
        return (
            self.codec.pack(self.count, sample, 2046, zone)
            if zone
            else self.codec.pack_idle(self.count, sample)
        )

    def _slot(self):
        now_ns = self.now_ns = self.now_ns + MS
        sealed = self.space.seal(self._frame(), now_ns)
        for end, out, back, source in (
            (self.space, self.out, self.back, GROUND_ADDRESS),
            (self.ground, self.back, self.out, SPACE_ADDRESS),
        ):
            while end.handle_rest(now_ns, now_ns + MS):
                pass
            while sealed is not None or (sealed := end.poll_transmit()) is not None:
                out.handle_datagram(sealed[0], now_ns)
                sealed = None
            while (datagram := back.poll_transmit(now_ns)) is not None:
                frame = end.handle_datagram(datagram, source, now_ns)
                while frame is not None:
                    late_ms = self.count - int.from_bytes(frame[2:5], "big")
                    self.delays_ms[now_ns // MS] = late_ms
                    frame = end.next_frame(now_ns)
        if self.space.allowed.state != self.states[-1][1]:
            self.states.append((now_ns // MS, self.space.allowed.state))

    @property
    def report(self):
        return self.space.report(self.now_ns)

    def since(self, begun_ms):
        return [state for at_ms, state in self.states if at_ms > begun_ms]


def conditions(**more):
    return Network(delay_ms=10, **more)


def test_what_does_not_pass_is_left_out_in_order_and_is_back_within_five_seconds():
    steps = ((5, 2120), (9, 1720), (13, 1460), (17, 1160), (21, 800), (25, 0))
    session = Session(conditions(rates=steps, loss=0.004)).run(25)
    assert list(dict.fromkeys(session.since(0))) == STATES[1:]
    assert session.since(0)[0] == session.since(5000)[0]
    assert session.report.video_cap_bps < VIDEO_BPS / 3
    session.run(5)
    assert session.states[-1][1] == "all" and session.report.path_why == ""
    assert session.report.video_cap_bps == VIDEO_BPS


@pytest.mark.parametrize("batch", [1, 4])
def test_a_path_that_is_suddenly_slow_is_followed_within_300_ms_and_samples_pass(batch):
    session = Session(conditions(rates=((5, 1000), (15, 0))), batch=batch).run(15)
    assert 5000 < session.states[1][0] <= 5350
    # The queue is gone within about a second, and tries make a short one only.
    late = sorted(ms for at_ms, ms in session.delays_ms.items() if at_ms > 6300)
    assert late[-1] < 170 and late[len(late) // 2] < 50
    begun, lower = session.report.events[:2]
    assert "begun" in begun.what and lower.what.startswith("over the path: ")
    assert len(session.report.events) <= 5
    assert session.run(5).states[-1][1] == "all"


@pytest.mark.parametrize(
    "more",
    [{"loss": 0.05}, {"jitter_ms": 20}, {"reordered": 0.1, "reorder_ms": 15}],
    ids=["loss", "jitter", "order"],
)
def test_random_losses_and_jitter_lower_nothing(more):
    session = Session(conditions(**more)).run(30)
    assert session.states == [(0, "all")]
    assert session.report.path_loss == pytest.approx(more.get("loss", 0), abs=0.04)


def test_constant_datagrams_keep_the_caps_and_say_what_would_help():
    session = Session(conditions(rates=((3, 3000), (43, 0))), compact=False).run(43)
    assert session.since(0) == ["too slow"] and session.space.allowed.cap_parts == PARTS
    assert session.report.path_why == "the path cannot carry the profile: use --path compact"
    assert session.report.path_bps == pytest.approx(3_000_000, rel=0.1)
    assert session.run(8).since(43_000) == ["all"]
    assert session.report.events[-1].what == "over the path: all"


def test_an_end_that_cannot_measure_gets_no_report_and_changes_nothing():
    session = Session(conditions(rate_kbps=900), peer_follows=False).run(3)
    assert session.states == [(0, "all")] and session.report.path_bps == 0
    assert session.ground.report(session.now_ns).dropped == {}


def test_a_report_by_hand_and_malformed_ones_are_counted():
    arrivals = Arrivals(MS)
    for sequence, count, at_ms in ((7, 0xFFFFFE, 30), (8, 0xFFFFFF, 30), (10, 1, 33), (9, 0, 33)):
        arrivals.handle_record(1, sequence, count, 110, at_ms * MS)
    arrivals.handle_record(2, 0, None, 54, 34 * MS)
    report = arrivals.poll_transmit(1_000 * MS)
    # Of the delays of 29, 28, 29 and 30 ms, but for an offset, the third smallest.
    assert report.hex() == "000f4240000001ee000000050000000500007148"
    assert arrivals.poll_transmit(1_099 * MS) is None
    assert PathReport.parse(report) == (1_000_000, 494, 5, 5, 29_000)
    random = Random(first_seed(1))
    follower = PathFollower(NEEDS)
    for turn in range(repeats(300)):
        parsed = PathReport.parse(mutate(random, report))
        if parsed is not None:
            follower.handle_report(parsed, turn * 1000, turn * 100 * MS, compact=turn % 7 > 0)
    session = Session(conditions()).run(1)
    sealed = session.space._seal(REPORT, report[1:], session.now_ns)
    assert session.ground.handle_datagram(*sealed, session.now_ns) is None
    assert session.ground.report(session.now_ns).dropped == {"malformed": 1}


def test_a_radio_that_hits_counts_and_a_jump_of_the_clock_look_like_no_queue():
    arrivals, follower, random = Arrivals(MS), PathFollower(NEEDS), Random(first_seed(2))
    for slot in range(20_000):
        # The peer begins anew with other counts, or the clock of this end is stepped.
        count, now_ns = slot + (500_000 if slot > 9000 else 0), (slot + 20 + slot // 15_000) * MS
        hit = random.random() < 0.003
        count ^= hit << random.randrange(24)
        arrivals.handle_record(1, slot, count & 0xFFFFFF, 110, now_ns)
        if (report := arrivals.poll_transmit(now_ns)) is not None:
            follower.handle_report(PathReport.parse(report), slot * 110, slot * MS, compact=True)
        assert follower.allowed == ALL


def test_whole_frames_during_a_try_begin_anew():
    follower, states = PathFollower(NEEDS), []
    for turn in range(40):
        # Datagrams wait, and more is tried later; then the other end reads whole frames only.
        late_ms = 20 + 100 * (5 <= turn < 8 or turn >= 25)
        sent = 25_000 * turn
        report = PathReport(100_000 * turn, sent // 2, 100 * turn, 100 * turn, late_ms * 1000)
        follower.handle_report(report, sent, turn * 100 * MS, compact=turn < 25)
        states.append(follower.allowed.state)
    assert states[8] == "fewer pictures" and "too slow" == states[-1] != states[24]


def test_the_longer_a_path_stays_slow_the_rarer_are_tries():
    follower, waiting, sent, tries = PathFollower(NEEDS), 0.0, 0, []
    for turn in range(3000):
        before = follower.allowed.cap_parts
        bits, passes = 70_000 + VIDEO_BPS // 10 * before // PARTS, 150_000
        waiting, sent = max(0.0, waiting + bits - passes), sent + bits // 8
        came = 9 * turn, 9 * turn, 20_000 + int(waiting / passes * 100_000)
        report = PathReport(turn * 100_000, sent - int(waiting / 8), *came)
        follower.handle_report(report, sent, turn * 100 * MS, compact=True)
        assert bool(follower.why) is (follower.allowed != ALL)
        if follower.allowed.cap_parts > before:
            tries.append(turn // 10)
    assert sum(second < 30 for second in tries) > 5
    assert 2 <= sum(second >= 200 for second in tries) <= 6

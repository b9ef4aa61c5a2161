"""Whatever arrives, in any order and any number of times: no joule is credited twice."""

from bisect import insort
from random import Random

from haptic_session import begin_session
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from kontur_av.clock import NS_PER_MS
from telepresence.haptics.bilateral import JoystickSide, RobotSide
from telepresence.haptics.loop import joystick_link, robot_link
from telepresence.haptics.sample import Command, Feedback, is_greeting, pack_command

#: One count of the energy in a sample.
COUNT_J = 1e-6


class Archive:
    """Two links, all datagrams that any of their lives has sent, and what each life granted."""

    def __init__(self, random: Random) -> None:
        self.random = random
        self.lives = 0
        self.now_ns = 0
        self.links = [joystick_link(), robot_link()]
        self.sent = [[], []]
        self.granted_uj = [0, 0]
        #: At the start of this life, and granted by lives that have ended.
        self.start_uj, self.granted_before_uj = [0, 0], [0, 0]
        self.heard_before_uj = [0, 0]
        for end in (0, 1):
            self.restart(end)

    def restart(self, end: int) -> None:
        self.heard_before_uj[end] += self.heard_uj(end)
        self.granted_before_uj[end] += self.granted_uj[end] - self.start_uj[end]
        # So far apart, and so few in a test, that no two sums of lives give one session number.
        self.lives += 8
        self.links[end] = (robot_link if end else joystick_link)(life=self.lives)
        self.granted_uj[end] = self.start_uj[end] = 0

    def heard_uj(self, end: int) -> int:
        latest = self.links[end].latest(0)
        return 0 if latest is None else latest.energy_uj

    def cycles(self, count: int, most_uj: int, reach: int) -> None:
        """Both ends send; of the newest `reach` datagrams, some arrive, in any order.

        reach: 0 delivers each datagram once, at once.
        """
        random = self.random
        for _ in range(count):
            self.now_ns += NS_PER_MS
            for end, link in enumerate(self.links):
                self.granted_uj[end] += random.randrange(most_uj + 1)
                uj = self.granted_uj[end]
                value = Feedback(0.0, 0.0, uj, False) if end else Command(0.0, 0.0, uj)
                link.handle_local(value, self.now_ns)
                self.sent[end].append(link.poll_transmit(self.now_ns))
            for end in (0, 1):
                newest = len(self.sent[end]) - 1
                for _ in range(random.randrange(3) if reach else 1):
                    back = random.randrange(reach) if reach else 0
                    self.deliver(end, max(0, newest - back), 1)

    def deliver(self, end: int, first: int, count: int) -> None:
        """Deliver datagrams of `end`, or of its earlier lives, to the present peer."""
        for data in self.sent[end][first : first + count]:
            self.links[1 - end].handle_datagram(data, self.now_ns)
            self.check()

    def check(self) -> None:
        for end in (0, 1):
            heard_uj = self.heard_before_uj[end] + self.heard_uj(end)
            granted_uj = self.granted_uj[1 - end] - self.start_uj[1 - end]
            assert heard_uj <= self.granted_before_uj[1 - end] + granted_uj


steps = st.one_of(
    st.tuples(
        st.just("run"),
        st.integers(1, 150),
        st.sampled_from([0, 10, 1_000, 60_000]),
        st.sampled_from([1, 3, 40]),
    ),
    st.tuples(st.just("replay"), st.integers(0, 1), st.floats(0, 1), st.integers(1, 80)),
    st.tuples(st.just("restart"), st.integers(0, 1)),
)


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.too_slow])
@given(steps=st.lists(steps, max_size=14), seed=st.integers(0, 1 << 32))
def test_no_order_of_delivery_credits_more_than_was_granted(steps, seed) -> None:
    """Over all lives of both ends: loss, repetition, reordering, replay and restarts."""
    archive = Archive(Random(seed))
    archive.cycles(20, 1_000, 1)
    for step in steps:
        match step:
            case "run", count, most_uj, reach:
                archive.cycles(count, most_uj, reach)
            case "replay", end, where, count:
                archive.deliver(end, int(where * len(archive.sent[end])), count)
            case "restart", end:
                archive.restart(end)
    # And it is not for lack of a session: on a good path both ends hear what the other grants.
    archive.cycles(200, 10, 0)
    for end, link in enumerate(archive.links):
        assert link.session.receiving
        heard_uj = archive.heard_uj(end)
        archive.cycles(30, 1_000, 0)
        assert archive.heard_uj(end) > heard_uj


def feed(side: RobotSide, samples: list[tuple[int, int, int]], cycle: int) -> None:
    """Let commands (session, sequence number, total) arrive, one in each cycle."""
    for session, sequence, total_uj in samples:
        data = pack_command(sequence, Command(0.0, 0.0, total_uj), session=session)
        side.handle_datagram(data, cycle * NS_PER_MS)
        side.handle_cycle(cycle * NS_PER_MS, NS_PER_MS)
        cycle += 1


def test_stale_samples_replayed_in_threes_give_no_credit() -> None:
    side = RobotSide()
    session = begin_session(side.link)
    feed(side, [(session, k, 1000 * k) for k in range(600)], 0)
    for k in range(600, 640, 2):
        feed(side, [(session, k, 599_000)], k)
        feed(side, [(session, q, 1000 * q) for q in (100, 101, 102)], k + 1)
    assert 0.59 < side.controller.port.received_j <= 0.599 + COUNT_J
    assert side.link.restarts == 0


def test_a_restart_and_a_return_of_the_old_stream_give_no_credit() -> None:
    """The old total stands anywhere, also just below the most that a sample carries."""
    for seed in range(20):
        random = Random(seed)
        side = RobotSide()
        session = begin_session(side.link, request=1 << 8)
        total_uj = (1 << 24) - 1 - random.randrange(2_000_000)
        feed(side, [(session, k, total_uj - 300 + k) for k in range(300)], 0)
        old, session = session, begin_session(side.link, request=2 << 8)
        arrivals = []
        for k in range(0, 300, 3):
            arrivals += [(session, k + j, 10 * (k + j)) for j in range(3)]
            # The old stream comes back on another route, or is replayed.
            arrivals += [(old, 300 + k + j, total_uj) for j in range(3)]
        feed(side, arrivals, 300)
        assert side.controller.port.received_j <= 300e-6 + 2990e-6 + COUNT_J
        assert side.link.restarts == 1


class Route:
    """A direction of the path: its delay alternates, and losses come in bursts."""

    def __init__(self, random: Random) -> None:
        self.random = random
        self.under_way: list[tuple[int, int, bytes]] = []
        self.lossy = False

    def handle_datagram(self, data: bytes, cycle: int) -> None:
        # Bursts of 10 on average, 10 % in all.
        self.lossy = self.random.random() < (0.9 if self.lossy else 0.1 / 9)
        if not self.lossy:
            delay = 50 if cycle // 2000 % 2 else 800
            insort(self.under_way, (cycle + delay, cycle, data))

    def due(self, cycle: int) -> list[bytes]:
        out = []
        while self.under_way and self.under_way[0][0] <= cycle:
            out.append(self.under_way.pop(0)[2])
        return out


def test_a_route_that_alternates_with_burst_loss_makes_no_energy() -> None:
    random = Random(1)
    joystick, robot = JoystickSide(), RobotSide()
    down, up = Route(random), Route(random)
    samples = 0
    for cycle in range(20_000):
        now_ns = cycle * NS_PER_MS
        for route, side in ((down, robot), (up, joystick)):
            for data in route.due(cycle):
                side.handle_datagram(data, now_ns)
        for side, route in ((robot, up), (joystick, down)):
            side.handle_cycle(now_ns, NS_PER_MS)
            data = side.poll_transmit(now_ns)
            samples += not is_greeting(data)
            route.handle_datagram(data, cycle)
        for side, peer in ((robot, joystick), (joystick, robot)):
            assert side.controller.port.received_j <= peer.controller.port.granted_j + COUNT_J
    for side in (robot, joystick):
        report = side.link
        assert report.restarts == 0 and report.late > 1000
        assert report.received > 8_000
        assert side.controller.least_observed_uj >= -1.0
        assert side.controller.port.received_j > 0.02
    assert samples > 0.85 * 2 * 20_000

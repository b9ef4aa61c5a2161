"""The ends of the haptic exchange: the newest sample wins, restarts, silence, and replays."""

from random import Random

import pytest
from haptic_pair import MS
from haptic_samples import unpack_command, unpack_feedback
from haptic_session import begin_session
from hypothesis import given, settings
from hypothesis import strategies as st

from kontur_av.clock import NS_PER_MS
from telepresence.haptics.haptic_metrics import SamplesReceived
from telepresence.haptics.loop import joystick_link, robot_link
from telepresence.haptics.sample import (
    FLAG_HOLDING,
    Command,
    Feedback,
    Greeting,
    pack_command,
    pack_feedback,
    pack_greeting,
)

REST = Feedback(0.0, 0.0, 0, False)


def command(x_m):
    return Command(x_m, 0.0, 0)


def started(**options):
    """The robot's link, and a function by which the joystick's samples arrive."""
    link = robot_link(**options)
    session = begin_session(link)

    def arrive(sequence, now_ns, x_m=0.0):
        link.handle_datagram(pack_command(sequence, command(x_m), session=session), now_ns)

    return link, arrive


def test_the_newest_sample_wins_and_a_late_one_is_not_used():
    link, arrive = started()
    for now_ms, sequence in enumerate([65534, 65535, 1, 0, 1]):
        arrive(sequence, now_ms * MS, sequence * 1e-5)
    # Half a count is none.
    assert link.latest(4 * MS).x_m == pytest.approx(0.0)
    assert link.sent == 0
    none = dict.fromkeys(("lost", "strays", "greetings", "garbage", "restarts"), 0)
    assert link.received_metrics() == SamplesReceived(
        received=3, late=1, repeated=1, sessions=1, **none
    )
    assert [sequence for sequence, _ in link.take_received_stamps()] == [65534, 65535, 1]
    assert link.take_received_stamps() == []


def test_sent_stamps_survive_a_wrap_of_numbers_and_drop_the_oldest():
    link, arrive = started()
    arrive(0, 0)
    numbers = []
    for now_ns in range(65_530, 65_540):
        link.sent = now_ns
        link.handle_local(REST, now_ns)
        numbers.append(unpack_feedback(link.poll_transmit(now_ns)).sequence)
    stamps = list(zip(numbers, range(65_530, 65_540), strict=True))
    assert stamps[6] == (0, 65_536) and link.take_sent_stamps() == stamps
    assert link.take_sent_stamps() == []
    for now_ns in range(9_000):
        link.handle_local(REST, now_ns)
        link.poll_transmit(now_ns)
    assert link.take_sent_stamps()[0] == ((65_540 + 9_000 - 8192) % 65_536, 9_000 - 8192)


@pytest.mark.parametrize(
    ("arrivals", "counts"),
    [
        # (sequence number, ms); received, lost, late, restarts
        ([(0, 0), (30_000, 30_000)], (2, 29_999, 0, 0)),
        ([(0, 0), (30_000, 0), (1, 0), (64_000, 0), (2, 0)], (3, 0, 2, 0)),
    ],
    ids=["an outage is loss", "a number beyond its time is not used"],
)
def test_a_number_counts_by_the_time_that_has_passed(arrivals, counts):
    link, arrive = started()
    for sequence, now_ms in arrivals:
        arrive(sequence, now_ms * MS)
    found = link.received_metrics()
    assert (found.received, found.lost, found.late, found.restarts) == counts


@pytest.mark.parametrize("newest", [100, 20_000, 50_000, 65_500])
def test_a_restarted_peer_is_heard_within_a_tenth_of_a_second(newest):
    link, arrive = started()
    now_ns = 0
    for sequence in range(newest - 50, newest + 1):
        now_ns += MS
        arrive(sequence, now_ns)
    now_ns += 500 * MS
    link.poll_transmit(now_ns)
    peer, heard = joystick_link(boot_id=2), []
    for sequence in range(200):
        now_ns += MS
        peer.handle_local(command(0.5), now_ns)
        link.handle_local(REST, now_ns)
        there, back = peer.poll_transmit(now_ns), link.poll_transmit(now_ns)
        link.handle_datagram(there, now_ns)
        peer.handle_datagram(back, now_ns)
        if link.latest(now_ns) == command(0.5):
            heard.append(sequence)
    assert heard[0] <= 100 and link.counts.lost < 100


def test_numbers_that_begin_anew_out_of_order_are_heard_within_a_tenth_of_a_second():
    link, arrive = started()
    arrive(7000, 0)
    # Each second sample is overtaken on its way.
    for k_ms, sequence in sorted((k + 40 * (k % 2), k) for k in range(150)):
        arrive(sequence, k_ms * MS, 0.5)
        if link.latest(k_ms * MS) == command(0.5):
            break
    assert k_ms <= 100


def test_silence_is_sent_to_the_peer():
    link = joystick_link(max_age_ns=20 * MS)
    link.handle_datagram(pack_feedback(0, REST, True, begin_session(link)), 5 * MS)
    assert link.peer_holds
    assert link.latest(25 * MS) is not None and link.latest(25 * MS + 1) is None
    for now_ms in (25, 26, 27):
        link.handle_local(command(0.1), now_ms * MS)
        sent = unpack_command(link.poll_transmit(now_ms * MS))
        assert bool(sent.flags & FLAG_HOLDING) is (now_ms > 25) is not link.hearing


@pytest.mark.rule("4")
def test_only_the_newest_sample_is_sent_and_only_once():
    link = joystick_link()
    # A greeting takes the place of a sample.
    link.handle_local(command(0.1), 0)
    assert link.poll_transmit(0) is not None and link.poll_transmit(0) is None
    link.handle_datagram(pack_feedback(0, REST, session=begin_session(link)), 0)
    assert link.poll_transmit(0) is None
    for x_m in (0.1, 0.2):
        link.handle_local(command(x_m), 0)
    assert unpack_command(link.poll_transmit(0)).value.x_m == pytest.approx(0.2)
    assert link.poll_transmit(1) is None


def test_a_restart_is_counted():
    link = robot_link()
    for boot_id, sequence in ((1, 40_000), (2, 7), (2, 8)):
        session = begin_session(link, request=boot_id << 8)
        link.handle_datagram(pack_command(sequence, command(0.0), session=session), 0)
    assert link.session.restarts == 1
    assert link.counts == SamplesReceived(received=3, sessions=3)


def test_a_greeting_alone_changes_nothing():
    """Neither a stale request nor a stale offer touches the session or what the peer is sent."""
    robot, joystick = robot_link(), joystick_link()
    sessions = begin_session(robot), begin_session(joystick)
    robot.handle_datagram(pack_command(0, command(0.1), session=sessions[0]), 0)
    push = Feedback(1.0, 0.0, 0, True)
    joystick.handle_datagram(pack_feedback(0, push, session=sessions[1]), 0)
    for sequence in range(1, 100):
        request = Greeting(sequence, 0x900 + sequence)
        robot.handle_datagram(pack_greeting(request, feedback=False, holding=True), sequence * MS)
        offer = Greeting(sequence, 0x900, sequence)
        joystick.handle_datagram(pack_greeting(offer, feedback=True, holding=True), sequence * MS)
        robot.handle_local(push, sequence * MS)
        joystick.handle_local(command(0.1), sequence * MS)
        assert robot.poll_transmit(sequence * MS) and joystick.poll_transmit(sequence * MS)
    assert (robot.session.receiving, joystick.session.receiving) == sessions
    assert (robot.session.sending, joystick.session.sending) == sessions
    # The joystick goes on as before; the robot answers now and then in the place of a sample.
    assert joystick.sent == 99 and 84 < robot.sent < 99


class Archive:
    """Two links, all datagrams that any of their lives has sent, and what each start granted."""

    def __init__(self, random: Random) -> None:
        self.random = random
        self.lives = 0
        self.now_ns = 0
        self.links = [joystick_link(), robot_link()]
        self.sent = [[], []]
        self.granted_uj = [0, 0]
        #: At the start of this start, and granted by starts that have ended.
        self.start_uj, self.granted_before_uj = [0, 0], [0, 0]
        self.heard_before_uj = [0, 0]
        for end in (0, 1):
            self.restart(end)

    def restart(self, end: int) -> None:
        self.heard_before_uj[end] += self.heard_uj(end)
        self.granted_before_uj[end] += self.granted_uj[end] - self.start_uj[end]
        # So far apart, and so few in a test, that no two sums of starts give one session number.
        self.lives += 8
        self.links[end] = (robot_link if end else joystick_link)(boot_id=self.lives)
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
        """Deliver datagrams of `end`, or of its earlier starts, to the present peer."""
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


@settings(max_examples=50)
@given(steps=st.lists(steps, max_size=14), seed=st.integers(0, 1 << 32))
def test_no_order_of_delivery_credits_more_than_was_granted(steps, seed):
    """Over all starts of both ends: loss, repetition, reordering, replay and restarts."""
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

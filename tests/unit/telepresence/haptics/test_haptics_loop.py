"""The ends of the haptic exchange: newest sample wins, restarts, silence, and the schedule."""

import pytest
from haptic_samples import unpack_command, unpack_feedback
from haptic_session import begin_session

from telepresence.haptics.figures import SamplesReceived
from telepresence.haptics.latency import LatencyMatcher
from telepresence.haptics.loop import PeerFound, PeerLost, PeerRestarted, joystick_link, robot_link
from telepresence.haptics.sample import (
    FLAG_HOLDING,
    Command,
    Feedback,
    Greeting,
    pack_command,
    pack_feedback,
    pack_greeting,
)
from telepresence.haptics.schedule import PeriodicSchedule

MS = 1_000_000


def command(x_m: float) -> Command:
    return Command(x_m, 0.0, 0)


def test_the_newest_sample_wins_and_a_late_one_is_not_used() -> None:
    link = robot_link()
    session = begin_session(link)
    for now_ms, sequence in enumerate([65534, 65535, 1, 0, 1]):
        data = pack_command(sequence, command(sequence * 1e-5), session=session)
        link.handle_datagram(data, now_ms * MS)
    newest = link.latest(4 * MS)
    assert newest is not None
    assert newest.x_m == pytest.approx(0.0)  # sequence 1 is half a count
    assert link.sent == 0
    assert link.received_figures() == SamplesReceived(
        received=3,
        lost=0,
        late=1,
        repeated=1,
        strays=0,
        greetings=0,
        garbage=0,
        sessions=1,
        restarts=0,
    )
    assert [sequence for sequence, _ in link.take_received_stamps()] == [65534, 65535, 1]
    assert link.take_received_stamps() == []


def test_sent_stamps_survive_a_wrap_of_numbers_and_drop_the_oldest() -> None:
    link = robot_link()
    link.handle_datagram(pack_command(0, command(0.0), session=begin_session(link)), 0)
    numbers = []
    for now_ns in range(65_530, 65_540):
        link.sent = now_ns
        link.handle_local(Feedback(0.0, 0.0, 0, False), now_ns)
        data = link.poll_transmit(now_ns)
        assert data is not None
        numbers.append(unpack_feedback(data).sequence)
    stamps = list(zip(numbers, range(65_530, 65_540), strict=True))
    assert stamps[6] == (0, 65_536) and link.take_sent_stamps() == stamps
    assert link.take_sent_stamps() == []
    for now_ns in range(20_000):
        link.handle_local(Feedback(0.0, 0.0, 0, False), now_ns)
        link.poll_transmit(now_ns)
    assert link.take_sent_stamps()[0] == ((65_540 + 20_000 - 8192) % 65_536, 20_000 - 8192)


def test_a_long_outage_counts_as_loss() -> None:
    link = robot_link()
    session = begin_session(link)
    link.handle_datagram(pack_command(0, command(0.0), session=session), 0)
    link.handle_datagram(pack_command(30_000, command(0.0), session=session), 30_000 * MS)
    assert (link.received, link.lost, link.restarts) == (2, 29_999, 0)


@pytest.mark.parametrize("newest", [100, 20_000, 50_000, 65_500])
def test_a_restarted_peer_is_heard_within_a_tenth_of_a_second(newest: int) -> None:
    link = robot_link()
    session = begin_session(link)
    now_ns = 0
    for sequence in range(newest - 50, newest + 1):
        now_ns += MS
        link.handle_datagram(pack_command(sequence, command(0.0), session=session), now_ns)
    now_ns += 500 * MS
    link.poll_transmit(now_ns)
    heard_after = None
    peer = joystick_link(life=2)
    for sequence in range(200):
        now_ns += MS
        peer.handle_local(command(0.5), now_ns)
        link.handle_local(Feedback(0.0, 0.0, 0, False), now_ns)
        there, back = peer.poll_transmit(now_ns), link.poll_transmit(now_ns)
        assert there is not None and back is not None
        link.handle_datagram(there, now_ns)
        peer.handle_datagram(back, now_ns)
        if heard_after is None and link.latest(now_ns) == command(0.5):
            heard_after = sequence
    assert heard_after is not None
    assert heard_after <= 100
    assert link.lost < 100


def test_numbers_that_begin_anew_out_of_order_are_heard_within_a_tenth_of_a_second() -> None:
    link = robot_link()
    session = begin_session(link)
    link.handle_datagram(pack_command(7000, command(0.0), session=session), 0)
    # Each second sample is overtaken on its way.
    arrivals = sorted((k + 40 * (k % 2), k) for k in range(150))
    for k_ms, sequence in arrivals:
        link.handle_datagram(pack_command(sequence, command(0.5), session=session), k_ms * MS)
        if link.latest(k_ms * MS) == command(0.5):
            break
    assert k_ms <= 100


def test_silence_is_reported_once_and_sent_to_the_peer() -> None:
    link = joystick_link(max_age_ns=20 * MS)
    data = pack_feedback(0, Feedback(0.0, 0.0, 0, False), True, begin_session(link))
    link.handle_datagram(data, 5 * MS)
    assert link.peer_holds
    assert link.poll_timeout() == 25 * MS + 1
    assert link.latest(25 * MS) is not None
    assert link.latest(25 * MS + 1) is None
    for now_ms in (25, 26, 27):
        link.handle_local(command(0.1), now_ms * MS)
        sent = link.poll_transmit(now_ms * MS)
        assert sent is not None
        assert bool(unpack_command(sent).flags & FLAG_HOLDING) is (now_ms > 25)
    assert link.next_event() == PeerFound(5 * MS)
    assert link.next_event() == PeerLost(26 * MS, 5 * MS)
    assert link.next_event() is None


def test_only_the_newest_sample_is_sent_and_only_once() -> None:
    link = joystick_link()
    # A greeting takes the place of a sample.
    link.handle_local(command(0.1), 0)
    assert link.poll_transmit(0) is not None
    assert link.poll_transmit(0) is None
    feedback = pack_feedback(0, Feedback(0.0, 0.0, 0, False), session=begin_session(link))
    link.handle_datagram(feedback, 0)
    assert link.poll_transmit(0) is None
    link.handle_local(command(0.1), 0)
    link.handle_local(command(0.2), 0)
    data = link.poll_transmit(0)
    assert data is not None
    assert unpack_command(data).value.x_m == pytest.approx(0.2)
    assert link.poll_transmit(1) is None


def test_restart_is_an_event() -> None:
    link = robot_link()
    for life, sequence in ((1, 40_000), (2, 7), (2, 8)):
        session = begin_session(link, request=life << 8)
        link.handle_datagram(pack_command(sequence, command(0.0), session=session), 0)
    assert link.next_event() == PeerFound(0)
    assert link.next_event() == PeerRestarted(0)
    assert (link.received, link.late, link.lost) == (3, 0, 0)


def test_a_greeting_alone_changes_nothing() -> None:
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
        answers = robot.poll_transmit(sequence * MS), joystick.poll_transmit(sequence * MS)
        assert all(answer is not None for answer in answers)
    assert (robot.session.receiving, joystick.session.receiving) == sessions
    assert (robot.session.sending, joystick.session.sending) == sessions
    # The joystick goes on as before; the robot answers now and then in the place of a sample.
    assert joystick.sent == 99 and 85 < robot.sent < 99


def test_a_number_beyond_its_time_is_not_used() -> None:
    link = robot_link()
    session = begin_session(link)
    for sequence in (0, 30_000, 1, 64_000, 2):
        link.handle_datagram(pack_command(sequence, command(0.0), session=session), sequence)
    assert (link.received, link.late) == (3, 2)


def test_a_missed_cycle_is_skipped_and_not_made_up() -> None:
    schedule = PeriodicSchedule(start_ns=10 * MS)
    assert schedule.handle_wakeup(10 * MS - 1) == -1
    assert schedule.cycles == 0
    assert schedule.handle_wakeup(10 * MS + 50_000) == 50_000
    assert (schedule.next_deadline_ns, schedule.slips, schedule.advance_ns) == (11 * MS, 0, MS)
    assert schedule.handle_wakeup(14 * MS + 1) == 3 * MS + 1
    assert (schedule.next_deadline_ns, schedule.slips) == (15 * MS, 3)
    assert schedule.advance_ns == 4 * MS
    assert schedule.handle_wakeup(14 * MS + 2) < 0
    assert schedule.cycles == 2


def test_deadlines_do_not_drift() -> None:
    schedule = PeriodicSchedule(start_ns=0)
    for _ in range(1000):
        schedule.handle_wakeup(schedule.next_deadline_ns + 70_000)
    assert (schedule.next_deadline_ns, schedule.slips) == (1000 * MS, 0)


def test_latencies_match_across_a_wrap_and_in_any_order_of_batches() -> None:
    matcher = LatencyMatcher()
    matcher.handle_received([(65535, 7 * MS), (0, 9 * MS)])
    assert [ns for _, ns in matcher.take_matches_ns(9 * MS)] == []
    matcher.handle_sent([(65535, 2 * MS), (0, 3 * MS)])
    assert [ns for _, ns in matcher.take_matches_ns(10 * MS)] == [5 * MS, 6 * MS]

    a_turn_later = 65_536 * MS
    matcher.handle_received([(0, a_turn_later + 9 * MS)])
    assert [ns for _, ns in matcher.take_matches_ns(a_turn_later + 9 * MS)] == []
    matcher.handle_sent([(0, a_turn_later + 3 * MS)])
    assert [ns for _, ns in matcher.take_matches_ns(a_turn_later + 10 * MS)] == [6 * MS]
    matcher.handle_received([(5, a_turn_later)])
    assert [ns for _, ns in matcher.take_matches_ns(a_turn_later + 6_000 * MS)] == []
    assert (matcher.unmatched, matcher.pending) == (1, 0)

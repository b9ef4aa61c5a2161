"""Sessions: how both ends agree on a number, and that no number is one under way already."""

from itertools import pairwise

import pytest

from telepresence.haptics.sample import Greeting
from telepresence.haptics.session import JoystickSession, RobotSession

MS = 1_000_000
#: Numbers of greetings begin with the number of the life, and end with their own octet.
OURS, THEIRS = 5 << 8, 7 << 8


def answer_to(robot: RobotSession, request: Greeting) -> Greeting:
    robot.handle_greeting(request)
    while (answer := robot.poll_greeting(0, 0)) is None:
        pass
    return answer


def test_a_request_to_another_life_is_offered_nothing():
    """Its session number is of the past: the successor may be, too."""
    robot = RobotSession(7)
    boot_id = answer_to(robot, Greeting(49, 0x100, 6 << 8))
    assert boot_id == Greeting(0, 7 << 8, 0x100)
    assert not any(robot.handle_change(session) for session in range(1, 256))
    assert answer_to(robot, Greeting(49, 0x100, boot_id.number)).session == 50


def test_an_offer_succeeds_the_session_that_began_not_the_last_that_was_offered():
    robot = RobotSession(7)
    known = answer_to(robot, Greeting(120, 0x100, 7 << 8)).session
    stale = answer_to(robot, Greeting(49, 0x101, 7 << 8)).session
    assert (known, stale) == (121, 50)
    assert robot.handle_change(known) and not robot.handle_change(stale)
    assert answer_to(robot, Greeting(121, 0x102, 7 << 8)).session == 122


def test_no_number_is_offered_that_samples_of_an_earlier_life_bear():
    """Both ends have just started, and samples of before are still on their way."""
    request = Greeting(0, 0x200, 7 << 8)
    number = answer_to(RobotSession(7), request).session
    robot = RobotSession(7)
    for session in (number, number + 1, number):
        assert not robot.handle_change(session)
    assert answer_to(robot, request).session == number + 2


def greeted(session, polls, granted_uj=0, now_ns=0):
    """What a session puts in the place of the next samples, by their number."""
    found = {}
    for number in range(polls):
        greeting = session.poll_greeting(granted_uj, now_ns)
        if greeting is not None:
            found[number] = greeting
    return found


def begun():
    joystick = JoystickSession(5)
    joystick.handle_greeting(Greeting(0, THEIRS))
    (request,) = greeted(joystick, 1).values()
    joystick.handle_greeting(Greeting(40, THEIRS, request.number))
    assert joystick.handle_change(40)
    return joystick


def test_a_joystick_asks_in_each_place_until_it_can_send_and_then_in_every_twentieth():
    joystick = JoystickSession(5)
    assert set(greeted(joystick, 30)) == set(range(30))
    joystick.handle_greeting(Greeting(0, THEIRS))
    assert set(greeted(joystick, 3).values()) == {Greeting(0, OURS, THEIRS)}
    # An answer to another request is ignored.
    joystick.handle_greeting(Greeting(9, THEIRS, OURS + 1))
    assert joystick.sending == 0
    joystick.handle_greeting(Greeting(40, THEIRS, OURS))
    assert (joystick.sending, joystick.receiving) == (40, 0)
    # It sends now, and asks on until a sample of the session comes.
    assert sorted(greeted(joystick, 60)) == [19, 39, 59]
    assert not joystick.handle_change(41) and joystick.handle_change(40)
    assert (joystick.sending, joystick.receiving, joystick.restarts) == (40, 40, 0)
    assert greeted(joystick, 100) == {}


def test_a_joystick_renews_a_session_before_its_numbers_or_energies_run_out():
    joystick = begun()

    def asks(granted_uj=0, now_ns=0):
        return list(greeted(joystick, 1, granted_uj, now_ns).values())

    assert asks(now_ns=0) == asks(now_ns=30_000 * MS - 1) == []
    assert asks(now_ns=30_000 * MS) == [Greeting(40, OURS + 1, THEIRS)]
    joystick = begun()
    half_uj = (1 << 24) // 2 - 1
    assert asks(half_uj) == [] and len(asks(half_uj + 1)) == 1
    # The renewed session has the same robot, so nobody has restarted.
    joystick.handle_greeting(Greeting(41, THEIRS, OURS + 1))
    assert joystick.handle_change(41) and joystick.restarts == 0
    # Its next renewal is 30 s after that.
    assert asks(now_ns=50_000 * MS) == asks(now_ns=79_999 * MS) == []
    assert len(asks(now_ns=80_000 * MS)) == 1
    joystick.handle_greeting(Greeting(42, 8 << 8, OURS + 2))
    assert joystick.handle_change(42) and joystick.restarts == 1


def test_strays_make_a_joystick_ask_anew_and_another_robot_makes_it_forget():
    joystick = begun()
    for _ in range(19):
        assert not joystick.handle_change(3)
    assert greeted(joystick, 1) == {}
    joystick.handle_change(3)
    assert (len(greeted(joystick, 1)), joystick.strays) == (1, 20)
    joystick.handle_greeting(Greeting(50, 9 << 8, OURS + 1, partner=True))
    assert joystick.partner_there
    joystick.begin_anew(for_partner=True)
    assert (joystick.sending, joystick.receiving, joystick.partner_there) == (0, 0, False)
    assert set(greeted(joystick, 2).values()) == {Greeting(0, OURS + 2, 0, True)}
    # The offer of before answers no longer, and another life is no restart.
    joystick.handle_greeting(Greeting(50, 9 << 8, OURS + 1))
    assert joystick.sending == 0
    joystick.handle_greeting(Greeting(60, 9 << 8, OURS + 2))
    assert joystick.handle_change(60) and joystick.restarts == 0


def test_a_robot_answers_each_eighth_place_and_tells_each_hundredth_of_a_partner():
    robot = RobotSession(7)
    assert set(greeted(robot, 5).values()) == {Greeting(0, THEIRS)} and robot.asking == 0
    robot.handle_greeting(Greeting(0, OURS, THEIRS))
    assert robot.asking == 5
    (offer,) = greeted(robot, 1).values()
    assert offer[1:] == (THEIRS, OURS, False)
    assert robot.handle_change(offer.session) and robot.sending == offer.session
    assert greeted(robot, 500) == {}
    robot.partner = True
    told = greeted(robot, 500)
    assert {b - a for a, b in pairwise(told)} == {100}
    assert set(told.values()) == {Greeting(offer.session, THEIRS, 0, True)}
    robot.partner = None
    found = []
    for number in range(40):
        robot.handle_greeting(Greeting(offer.session, OURS + 1, THEIRS))
        found += [number] * len(greeted(robot, 1))
    assert found == [0, 8, 16, 24, 32]
    # The next session is of the same life; one of another life is a restart.
    robot.handle_change(offer.session + 1)
    assert (robot.receiving, robot.restarts) == (offer.session + 1, 0)
    robot.handle_greeting(Greeting(0, 6 << 8, THEIRS))
    (offer,) = greeted(robot, 8).values()
    assert robot.handle_change(offer.session) and robot.restarts == 1


def test_a_robot_remembers_eight_offers_and_repeats_them():
    robot = RobotSession(7)
    requests = [Greeting(0, OURS + number, THEIRS) for number in range(9)]
    offers = [answer_to(robot, request).session for request in requests]
    assert len(set(offers)) == 9
    assert [answer_to(robot, request).session for request in requests[1:]] == offers[1:]
    assert not robot.handle_change(offers[0]) and robot.handle_change(offers[1])
    # It has the session that began, and no other of these offers.
    assert not robot.handle_change(offers[2])


@pytest.mark.parametrize("session", [JoystickSession, RobotSession])
def test_the_number_of_a_life_has_a_range(session):
    for number in (0, -1, 1 << 24):
        with pytest.raises(ValueError, match="1 to 16777215"):
            session(number)
    assert session((1 << 24) - 1).restarts == session(1).restarts == 0


def test_a_session_number_is_followed_by_the_next_and_the_last_by_the_first():
    for before, after in ((254, 255), (255, 1), (1, 2)):
        assert answer_to(RobotSession(7), Greeting(before, OURS, THEIRS)).session == after
    # Two ends that have just begun take it from both of their lives.
    assert answer_to(RobotSession(7), Greeting(0, OURS + 3, THEIRS)).session == 5 + 7 + 1

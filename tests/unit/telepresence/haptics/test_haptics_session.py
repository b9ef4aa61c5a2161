"""Sessions: no number is offered that a sample under way may bear."""

from telepresence.haptics.sample import Greeting
from telepresence.haptics.session import RobotSession


def answer_to(robot: RobotSession, request: Greeting) -> Greeting:
    robot.handle_greeting(request)
    while (answer := robot.poll_greeting(0, 0)) is None:
        pass
    return answer


def test_a_request_to_another_life_is_offered_nothing() -> None:
    """Its session number is of the past: the successor may be, too."""
    robot = RobotSession(7)
    life = answer_to(robot, Greeting(49, 0x100, 6 << 8))
    assert life == Greeting(0, 7 << 8, 0x100)
    assert not any(robot.handle_change(session) for session in range(1, 256))
    assert answer_to(robot, Greeting(49, 0x100, life.number)).session == 50


def test_an_offer_succeeds_the_session_that_began_not_the_last_that_was_offered() -> None:
    robot = RobotSession(7)
    known = answer_to(robot, Greeting(120, 0x100, 7 << 8)).session
    stale = answer_to(robot, Greeting(49, 0x101, 7 << 8)).session
    assert (known, stale) == (121, 50)
    assert robot.handle_change(known) and not robot.handle_change(stale)
    assert answer_to(robot, Greeting(121, 0x102, 7 << 8)).session == 122


def test_no_number_is_offered_that_samples_of_an_earlier_life_bear() -> None:
    """Both ends have just started, and samples of before are still on their way."""
    request = Greeting(0, 0x200, 7 << 8)
    number = answer_to(RobotSession(7), request).session
    robot = RobotSession(7)
    for session in (number, number + 1, number):
        assert not robot.handle_change(session)
    assert answer_to(robot, request).session == number + 2

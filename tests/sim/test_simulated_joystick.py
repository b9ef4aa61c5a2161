"""The joystick in operation in a whole session on virtual time, commanded from the ground."""

import pytest
from tmtc_session import Session

from pipelines.mission.tmtc_messages import CommandUpdate, Reported
from pipelines.session.setup.segments import Segment
from telepresence.haptics.device.simulated import SimulatedDevice
from telepresence.haptics.device.states import JoystickState
from telepresence.haptics.hand import Hand

GROUND = Segment.GROUND


@pytest.fixture
def session():
    """A session whose joystick is in the application."""
    made = Session(answers=False, joystick=SimulatedDevice(hand=Hand()))
    made.handle = made.simulation.tmtc._handle
    for _ in range(60):
        made.run(0.5)
        if made.handle.state == JoystickState.APPLICATION:
            return made
    pytest.fail("it did not come into the application")


def call(session, number, name):
    """Call a function of the joystick from the ground; return why it failed, or ""."""
    session.command(GROUND, number, "joystick", "call", name)
    session.run(1)
    (done,) = [one for one in session.of(GROUND, CommandUpdate) if one.done and one.id == number]
    assert done.verified and done.ok is (done.reason == "")
    return done.reason


def events(session):
    return [one.name for one in session.of(GROUND, Reported) if one.kind == "event"]


def test_it_is_halted_and_resumed_from_the_ground_and_the_robot_rests_meanwhile(session):
    robot = session.simulation.robot_desk.control.robot
    assert call(session, 1, "halt") == ""
    assert session.handle.state == JoystickState.HALTED
    session.run(2)
    place_m = robot.x_m, robot.y_m
    session.run(2)
    assert (robot.x_m, robot.y_m) == pytest.approx(place_m, abs=1e-3)
    assert events(session)[-2:] == ["state_changed", "off_nominal"]
    assert call(session, 2, "resume") == ""
    assert session.handle.state == JoystickState.APPLICATION


def test_its_functional_test_is_an_application_of_its_own(session):
    assert call(session, 1, "stop") == ""
    assert call(session, 2, "test") == ""
    for _ in range(60):
        session.run(1)
        if "test_passed" in events(session):
            break
    else:
        pytest.fail(f"no end of the test: {events(session)}")
    session.command(GROUND, 3, "joystick", "report", "state")
    session.run(1)
    reported = session.of(GROUND, Reported)
    report = [one for one in reported if (one.application, one.name) == ("joystick", "state")][-1]
    assert report.values["application"] == "none"

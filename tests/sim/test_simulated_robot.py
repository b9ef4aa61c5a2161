"""Robot and joystick of a whole session on virtual time, commanded by telecommands."""

from math import hypot

import pytest
from tmtc_session import Session

from pipelines.mission.tmtc_messages import CommandUpdate, Reported
from pipelines.session.setup.segments import Segment
from telepresence.haptics.device.simulated import SimulatedDevice
from telepresence.haptics.device.states import JoystickState
from telepresence.haptics.hand import Hand

SPACE, GROUND = Segment.SPACE, Segment.GROUND


def call(session, number, name, *arguments, joystick=False):
    """Call a function of the robot from space, or of the joystick from the ground.

    Return why it failed, or "".
    """
    segment = GROUND if joystick else SPACE
    application = "joystick" if joystick else "robot"
    session.command(segment, number, application, "call", name, arguments=arguments)
    session.run(1)
    (done,) = [one for one in session.of(segment, CommandUpdate) if one.done and one.id == number]
    assert done.verified and done.ok is (done.reason == "")
    return done.reason


def way_m(session, seconds=3):
    """Return how far from its place the tip comes."""
    robot = session.simulation.robot_commands.control.robot
    x_m, y_m = robot.x_m, robot.y_m
    farthest_m = 0.0
    for _ in range(seconds * 20):
        session.run(0.05)
        farthest_m = max(farthest_m, hypot(robot.x_m - x_m, robot.y_m - y_m))
    return farthest_m


def test_power_and_mode_are_commanded_from_space_and_no_hand_leads_it_meanwhile():
    session = Session(answers=False)
    session.run(3)
    assert "switch it off first" in call(session, 1, "set_mode", "position")
    assert call(session, 2, "power_off") == ""
    assert way_m(session) < 1e-3
    assert call(session, 3, "set_mode", "position") == ""
    assert call(session, 4, "power_on") == ""
    assert way_m(session) < 2e-3
    session.command(SPACE, 5, "robot", "report", "controller")
    session.run(1)
    reports = [one for one in session.of(SPACE, Reported) if one.name == "controller"]
    values = reports[-1].values
    assert (values["powered"], values["mode"], values["error_kind"]) == (True, "position", "none")
    assert values["hold"] == "the robot was off"
    assert call(session, 6, "power_off") == call(session, 7, "set_mode", "telepresence") == ""
    assert call(session, 8, "power_on") == ""
    assert way_m(session) > 0.01


def test_a_broken_limit_is_an_event_and_the_robot_stays_off_until_it_is_reset():
    session = Session(answers=False)
    session.run(3)
    robot = session.simulation.robot_commands.control.robot
    robot.vx_m_s = 2.0
    session.run(2)
    (event,) = [one for one in session.of(SPACE, Reported) if one.kind == "event"]
    assert (event.application, event.values) == ("robot", {"error": "speed"})
    assert "reset it first: faster than 1.5 m/s" in call(session, 1, "power_on")
    assert call(session, 2, "reset_error") == ""
    assert not session.simulation.robot_commands.control.powered
    assert call(session, 3, "power_on") == ""
    assert session.simulation.robot_commands.control.telepresent


def events(session):
    return [one.name for one in session.of(GROUND, Reported) if one.kind == "event"]


def test_the_joystick_is_halted_tested_and_resumed_and_the_robot_rests_meanwhile():
    session = Session(answers=False, joystick=SimulatedDevice(hand=Hand()))
    handle = session.simulation._joystick.side.handle
    robot = session.simulation.robot_commands.control.robot
    while handle.state != JoystickState.APPLICATION and session.now_ns < 30 * 10**9:
        session.run(0.5)
    assert call(session, 1, "halt", joystick=True) == ""
    assert handle.state == JoystickState.HALTED
    session.run(2)
    position_m = robot.x_m, robot.y_m
    session.run(2)
    assert (robot.x_m, robot.y_m) == pytest.approx(position_m, abs=1e-3)
    assert events(session)[-2:] == ["state_changed", "off_nominal"]
    assert call(session, 2, "resume", joystick=True) == ""
    assert handle.state == JoystickState.APPLICATION
    # Its functional test is an application of its own.
    assert call(session, 3, "stop", joystick=True) == call(session, 4, "test", joystick=True) == ""
    ends_ns = session.now_ns + 60 * 10**9
    while "test_passed" not in events(session) and session.now_ns < ends_ns:
        session.run(1)
    assert "test_passed" in events(session)
    session.command(GROUND, 5, "joystick", "report", "state")
    session.run(1)
    reported = session.of(GROUND, Reported)
    report = [one for one in reported if (one.application, one.name) == ("joystick", "state")][-1]
    assert report.values["application"] == "none"

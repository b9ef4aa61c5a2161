"""The joystick of a whole session on virtual time, commanded by telecommands."""

import pytest
from tmtc_session import Session

from pipelines.mission.tmtc_messages import CommandUpdate, Reported
from pipelines.session.setup.segments import Segment
from telepresence.haptics.device.simulated import SimulatedDevice
from telepresence.haptics.device.states import JoystickState
from telepresence.haptics.hand import Hand

GROUND = Segment.GROUND


def call(session, number, name):
    """Call a function of the joystick from the ground; it is carried out and verified."""
    session.command(GROUND, number, "joystick", "call", name)
    session.run(1)
    (done,) = [one for one in session.of(GROUND, CommandUpdate) if one.done and one.id == number]
    assert done.verified and done.ok, done.reason


def events(session):
    return [one.name for one in session.of(GROUND, Reported) if one.kind == "event"]


def test_the_joystick_is_halted_tested_and_resumed_and_the_robot_rests_meanwhile():
    session = Session(answers=False, joystick=SimulatedDevice(hand=Hand()))
    handle = session.simulation._joystick.side.handle
    robot = session.simulation.robot_commands.control.robot
    while handle.state != JoystickState.APPLICATION and session.now_ns < 30 * 10**9:
        session.run(0.5)
    call(session, 1, "halt")
    assert handle.state == JoystickState.HALTED
    session.run(2)
    position_m = robot.x_m, robot.y_m
    session.run(2)
    assert (robot.x_m, robot.y_m) == pytest.approx(position_m, abs=1e-3)
    assert events(session)[-2:] == ["state_changed", "off_nominal"]
    call(session, 2, "resume")
    assert handle.state == JoystickState.APPLICATION
    # Its functional test is an application of its own.
    call(session, 3, "stop")
    call(session, 4, "test")
    ends_ns = session.now_ns + 60 * 10**9
    while "test_passed" not in events(session) and session.now_ns < ends_ns:
        session.run(1)
    assert "test_passed" in events(session)
    session.command(GROUND, 5, "joystick", "report", "state")
    session.run(1)
    reported = session.of(GROUND, Reported)
    report = [one for one in reported if (one.application, one.name) == ("joystick", "state")][-1]
    assert report.values["application"] == "none"

"""The robot controller of a whole session on virtual time, commanded from space."""

from math import hypot

from tmtc_session import Session

from pipelines.mission.tmtc_messages import CommandUpdate, Reported
from pipelines.session.setup.segments import Segment

SPACE = Segment.SPACE


def call(session, number, name, *arguments):
    """Call a function of the robot from space; return why it failed, or ""."""
    session.command(SPACE, number, "robot", "call", name, arguments=arguments)
    session.run(1)
    (done,) = [one for one in session.of(SPACE, CommandUpdate) if one.done and one.id == number]
    assert done.verified and done.ok is (done.reason == "")
    return done.reason


def way_m(session, seconds=3):
    """Return how far from its place the tip comes."""
    robot = session.simulation.robot_desk.control.robot
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
    assert (values["powered"], values["mode"], values["error"]) == (True, "position", "none")
    assert values["hold"] == "the robot was off"
    assert call(session, 6, "power_off") == call(session, 7, "set_mode", "telepresence") == ""
    assert call(session, 8, "power_on") == ""
    assert way_m(session) > 0.01


def test_a_broken_limit_is_an_event_and_the_robot_stays_off_until_it_is_reset():
    session = Session(answers=False)
    session.run(3)
    robot = session.simulation.robot_desk.control.robot
    robot.vx_m_s = 2.0
    session.run(2)
    (event,) = [one for one in session.of(SPACE, Reported) if one.kind == "event"]
    assert (event.application, event.values) == ("robot", {"error": "speed"})
    assert "reset it first: faster than 1.5 m/s" in call(session, 1, "power_on")
    assert call(session, 2, "reset_error") == ""
    assert not session.simulation.robot_desk.control.powered
    assert call(session, 3, "power_on") == ""
    assert session.simulation.robot_desk.control.telepresent

"""The functional test of a joystick in a session."""

import pytest

from kontur_av.clock import NS_PER_MS
from telepresence.haptics.device.functional_test import FORCE_N, Outcome, TestPart
from telepresence.haptics.device.handle import OperatedHandle
from telepresence.haptics.device.page import PageDevice, PageInput
from telepresence.haptics.device.simulated import FACTS, FAULTS, Faults, Fingers, SimulatedDevice
from telepresence.haptics.device.states import JoystickEvent, JoystickState
from telepresence.haptics.hand import Hand
from telepresence.haptics.sample import Feedback

QUIET = Feedback(0.0, 0.0, 0, False)


class Session:
    """An operated handle with a robot, after a person has stopped the application."""

    def __init__(self, faults=None, device=None):
        self.device = device or SimulatedDevice(faults, hand=Hand())
        self.handle = OperatedHandle(self.device)
        self.operation = self.handle.operation
        self.run(4)
        assert self.handle.state == JoystickState.APPLICATION
        assert self.handle.handle_command(JoystickEvent.STOP) == ""
        self.run(0.5)
        self.pushes, self.states = [], set()
        write = self.device.write_force

        def note(x_n, y_n):
            self.pushes.append((x_n, y_n, self.device.read().dead_man))
            write(x_n, y_n)

        self.device.write_force = note

    def run(self, seconds, each=None):
        for _ in range(round(seconds * 1000)):
            self.handle.handle_feedback(QUIET)
            self.handle.step(0.0, 0.0, NS_PER_MS)
            if each is not None:
                each()

    def test(self, seconds=60, each=None):
        """Test, and return what became of it."""
        assert self.handle.handle_command(JoystickEvent.TEST) == ""
        for _ in range(round(seconds * 1000)):
            self.run(0.001, each)
            self.states.add((self.handle.state, self.handle.dead_man))
            if not self.operation.testing:
                self.run(0.1)
                break
        return self.operation.test


def test_a_healthy_joystick_passes_and_leads_no_robot_meanwhile():
    session = Session()
    report = session.test()
    assert (report.outcome, report.reason, report.number) == (Outcome.PASSED, "", 1)
    assert {figure.name for figure in report.figures} >= {
        *("left end", "right end", "lower end", "upper end", "stiffness x", "stiffness y"),
        *("Coulomb friction x", "viscous friction y", "button 4 pressed and let go"),
    }
    assert session.states == {(JoystickState.CALIBRATED, False)}
    strongest = max(max(abs(x_n), abs(y_n)) for x_n, y_n, _ in session.pushes)
    assert 4.0 < strongest <= FORCE_N
    assert all(dead_man or (x_n, y_n) == (0.0, 0.0) for x_n, y_n, dead_man in session.pushes)
    # A person has stopped the application, and must start it.
    session.run(3)
    assert session.handle.state == JoystickState.CALIBRATED
    assert [entry.event for entry in session.handle.report().log][-2:] == ["test", "test passed"]
    session.handle.handle_command(JoystickEvent.START)
    session.run(1)
    assert (session.handle.state, session.handle.dead_man) == (JoystickState.APPLICATION, True)


def test_motors_that_are_too_weak_fail_it():
    report = Session(FAULTS["weak"]).test()
    assert (report.outcome, report.part) == (Outcome.FAILED, TestPart.FORCE)
    assert report.reason.startswith("stiffness x: 11")


@pytest.mark.parametrize(
    ("fault", "part", "words"),
    [
        ("friction", TestPart.FRICTION, "Coulomb friction x"),
        ("button", TestPart.BUTTONS, "button "),
    ],
)
def test_each_other_part_fails_by_what_it_measures(fault, part, words):
    report = Session(FAULTS[fault]).test()
    assert (report.outcome, report.part) == (Outcome.FAILED, part)
    assert report.reason.startswith(words)
    (bad,) = [figure for figure in report.figures if not figure.passed][:1]
    assert bad.name in report.reason


@pytest.mark.parametrize("axis", [0, 1])
def test_an_axis_that_is_stuck_fails_it(axis):
    session = Session(Faults())
    session.device.stuck = axis
    report = session.test()
    assert (report.outcome, report.part) == (Outcome.FAILED, TestPart.PLACE)
    assert f"axis {'xy'[axis]} does not move" in report.reason


def test_without_the_dead_man_button_it_fails_and_never_pushes():
    session = Session()
    session.device.write_leds = lambda mask: None
    report = session.test()
    assert (report.outcome, report.part) == (Outcome.FAILED, TestPart.DEAD_MAN)
    assert report.reason == "the dead-man button was not pressed"
    assert {(x_n, y_n) for x_n, y_n, _ in session.pushes} == {(0.0, 0.0)}


def pushing(session):
    session.run(3)
    assert session.operation.testing and session.pushes[-1][2]


def test_it_aborts_with_the_next_cycle_after_the_button_is_let_go():
    session = Session()
    session.handle.handle_command(JoystickEvent.TEST)
    pushing(session)
    session.device.fingers = Fingers(FACTS.leds)
    session.run(0.002)
    assert session.pushes[-1][:2] == (0.0, 0.0)
    report = session.operation.test
    assert (report.outcome, report.reason) == (Outcome.ABORTED, "the dead-man button was let go")


@pytest.mark.parametrize(
    "event", [JoystickEvent.HALT, JoystickEvent.STOP, JoystickEvent.START, JoystickEvent.CALIBRATE]
)
def test_a_command_aborts_it_at_once(event):
    session = Session()
    session.handle.handle_command(JoystickEvent.TEST)
    pushing(session)
    assert session.handle.handle_command(event) == ""
    assert not session.operation.testing
    session.run(0.001)
    assert abs(session.pushes[-1][0]) + abs(session.pushes[-1][1]) == 0.0
    report = session.operation.test
    assert report.outcome is Outcome.ABORTED
    assert event.value in report.reason


def test_a_fault_aborts_it():
    session = Session()
    session.handle.handle_command(JoystickEvent.TEST)
    pushing(session)
    session.handle.handle_exercise(2_000_000_000)
    session.run(0.02)
    assert session.handle.state == JoystickState.RECOVERABLE
    report = session.operation.test
    assert report.outcome is Outcome.ABORTED and "exercise" in report.reason
    assert session.pushes[-1][:2] == (0.0, 0.0)


def test_it_is_refused_in_the_application():
    session = Session()
    session.handle.handle_command(JoystickEvent.START)
    session.run(1)
    refusal = session.handle.handle_command(JoystickEvent.TEST)
    assert "not in the state application; allowed there: stop" in refusal
    assert session.operation.test.outcome is Outcome.NONE


def test_a_person_at_a_page_does_it():
    device = PageDevice()
    session = Session(device=device)
    sequence = 0

    def look():
        nonlocal sequence
        sequence += 1
        pressed = device.leds == (1 << device.facts.leds) - 1
        device.handle_input(PageInput(pressed, 0.0, 0.0, 0, sequence, sequence * NS_PER_MS))

    report = session.test(each=look)
    assert (report.outcome, report.reason) == (Outcome.PASSED, "")

"""The functional test of a joystick in a session, and of a stick that a person moves."""

import pytest
from joystick_scripts import STICK, Person, edge, play

from kontur_av.clock import NS_PER_MS
from telepresence.haptics.device.functional_test import FORCE_N, Outcome, TestPart, functional_test
from telepresence.haptics.device.handle import OperatedHandle
from telepresence.haptics.device.simulated import CAPABILITIES, FAULTS, Fingers, SimulatedDevice
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
    assert {figure.name for figure in report.metrics} >= {
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


@pytest.mark.parametrize(
    ("fault", "part", "words"),
    [
        ("weak", TestPart.FORCE, "stiffness x: 11"),
        ("friction", TestPart.FRICTION, "Coulomb friction x"),
        ("button", TestPart.BUTTONS, "button "),
    ],
)
def test_each_part_fails_by_what_it_measures(fault, part, words):
    report = Session(FAULTS[fault]).test()
    assert (report.outcome, report.part) == (Outcome.FAILED, part)
    assert report.reason.startswith(words)
    bad = next(figure for figure in report.metrics if not figure.passed)
    assert bad.name in report.reason


def test_without_the_dead_man_button_it_fails_and_never_pushes():
    session = Session()
    session.device.write_leds = lambda mask: None
    report = session.test()
    assert (report.outcome, report.part) == (Outcome.FAILED, TestPart.DEAD_MAN)
    assert report.reason == "the dead-man button was not pressed"
    assert {(x_n, y_n) for x_n, y_n, _ in session.pushes} == {(0.0, 0.0)}


@pytest.fixture
def pushing():
    """A session whose test pushes the handle."""
    session = Session()
    session.handle.handle_command(JoystickEvent.TEST)
    session.run(3)
    assert session.operation.testing and session.pushes[-1][2]
    return session


def assert_aborted(session, within_s, words):
    session.run(within_s)
    assert session.pushes[-1][:2] == (0.0, 0.0)
    report = session.operation.test
    assert report.outcome is Outcome.ABORTED and words in report.reason


@pytest.mark.rule("S4")
def test_it_aborts_with_the_next_cycle_after_the_button_is_let_go(pushing):
    pushing.device.fingers = Fingers(CAPABILITIES.leds)
    assert_aborted(pushing, 0.002, "the dead-man button was let go")


@pytest.mark.parametrize(
    "event", [JoystickEvent.HALT, JoystickEvent.STOP, JoystickEvent.START, JoystickEvent.CALIBRATE]
)
def test_a_command_aborts_it_at_once(pushing, event):
    assert pushing.handle.handle_command(event) == ""
    assert not pushing.operation.testing
    assert_aborted(pushing, 0.001, event.value)


def test_a_fault_aborts_it(pushing):
    pushing.handle.handle_exercise(2_000_000_000)
    assert_aborted(pushing, 0.02, "no valid reading")
    assert pushing.handle.state == JoystickState.RECOVERABLE


def test_it_is_refused_in_the_application():
    session = Session()
    session.handle.handle_command(JoystickEvent.START)
    session.run(1)
    refusal = session.handle.handle_command(JoystickEvent.TEST)
    assert "not in the state application; allowed there: stop" in refusal
    assert session.operation.test.outcome is Outcome.NONE


@pytest.mark.parametrize(
    ("ignores", "outcome", "part", "words"),
    [
        ((), Outcome.PASSED, TestPart.NONE, ""),
        (("press and hold",), Outcome.FAILED, TestPart.DEAD_MAN, "was not pressed"),
        (("press button 1",), Outcome.FAILED, TestPart.BUTTONS, "button 1 pressed and let go: 0"),
    ],
)
def test_a_stick_tests_itself_while_the_dead_man_button_is_held(ignores, outcome, part, words):
    person = Person(ignores)

    def answer(ms, output):
        x_m, y_m = edge(ms)[:2]
        return person(ms, output)._replace(x_m=x_m, y_m=y_m)

    report, wanted = play(functional_test(STICK), answer)
    assert (report.outcome, report.part) == (outcome, part)
    assert words in report.reason
    assert "along its edge" in " ".join(person.prompts) or "was not pressed" in words
    if "was not pressed" in words:
        assert 10_000 <= len(wanted) <= 10_010


@pytest.mark.parametrize(("after_ms", "metrics"), [(0, 0), (500, 4)])
def test_a_dead_man_button_that_stays_pressed_fails_the_test(after_ms, metrics):
    person = Person()
    person.dead_man = after_ms == 0

    def answer(ms, output):
        if person.dead_man:
            person.ignores = ("let go",)
        x_m, y_m = edge(ms)[:2]
        return person(ms, output)._replace(x_m=x_m, y_m=y_m)

    report, wanted = play(functional_test(STICK), answer)
    assert (report.outcome, report.part) == (Outcome.FAILED, TestPart.DEAD_MAN)
    assert report.reason == "the dead-man button was not let go"
    assert len(report.metrics) == metrics and len(wanted) >= 10_000

"""Scripts that move a handle, played against sensors that the test makes up."""

from dataclasses import replace
from math import hypot, pi, sin

import pytest

from telepresence.haptics.device.checks import CheckBench
from telepresence.haptics.device.device import JoystickFacts, JoystickReading
from telepresence.haptics.device.functional_checks import (
    buttons_check,
    friction_check,
    spring_check,
    stiffness_figures,
    workspace_check,
)
from telepresence.haptics.device.functional_test import Outcome, TestPart, functional_test
from telepresence.haptics.device.operation import calibrate
from telepresence.haptics.device.script import (
    IDLE,
    CheckResult,
    Figure,
    ScriptRun,
    push_to_stop,
    travel,
)
from telepresence.haptics.device.simulated import FACTS, SimulatedDevice

MS = 1_000_000
REST = JoystickReading(0.0, 0.0, 0.0, 0.0, dead_man=False)
STICK = JoystickFacts(name="stick", half_width_m=0.1, half_height_m=0.08, buttons=3, leds=2)


def play(script, answer, most_ms=70_000):
    """Play a script at 1 kHz; `answer(ms, output)` is what the sensors read.

    Return its result, and what it wanted in each millisecond.
    """
    run, wanted, output = ScriptRun(script), [], IDLE
    for ms in range(most_ms):
        output = run.handle_reading(answer(ms, output), ms * MS)
        if run.result is not None:
            # A script that has ended wants nothing.
            assert output == run.handle_reading(REST, ms * MS) == IDLE
            return run.result, wanted
        wanted.append(output)
    raise AssertionError("the script does not end")


def begun(function, *arguments, **options):
    """A script that is handed its first cycle."""
    cycle = yield IDLE
    return (yield from function(cycle, *arguments, **options))


def stuck(ms, output):
    return REST


def test_a_travel_leads_at_its_speed_and_then_overcomes_friction_slowly():
    (_, there), wanted = play(begun(travel, 0.03, 0.04), stuck)
    # It gives up after 3 s. Its spring has 300 N/m, its setpoint moves at 0.15 m/s.
    assert not there and len(wanted) == 3000
    assert wanted[0][:2] == pytest.approx((0.0, 0.0))
    for ms in (1, 100, 333):
        assert wanted[ms][:2] == pytest.approx((0.6 * 0.045 * ms, 0.8 * 0.045 * ms))
    # From 0.334 s on, each axis is pushed by 10 N/s more.
    for ms in (400, 2999):
        more_n = (ms - 333) * 0.01
        assert wanted[ms][:2] == pytest.approx((9.0 + more_n, 12.0 + more_n))
    _, wanted = play(begun(travel, -0.03, -0.04, force_n=8.0, patience_ns=1000 * MS), stuck)
    assert max(hypot(x_n, y_n) for x_n, y_n, *_ in wanted) == pytest.approx(8.0)
    assert len(wanted) == 1000 and wanted[999].x_n < -4.0 and wanted[999].y_n < -4.0


@pytest.mark.parametrize(
    ("reading", "there"),
    [
        ((0.0519, 0.0281, 0.0, 0.0), True),
        ((0.0521, 0.03, 0.0, 0.0), False),
        ((0.05, 0.0279, 0.0, 0.0), False),
        ((0.05, 0.03, 0.003, 0.0039), True),
        ((0.05, 0.03, -0.004, -0.0031), False),
    ],
)
def test_a_travel_ends_at_rest_near_its_goal(reading, there):
    def answer(ms, output):
        return REST if ms < 100 else JoystickReading(*reading)

    (cycle, found), wanted = play(begun(travel, 0.05, 0.03, patience_ns=500 * MS), answer)
    # Rest is 40 ms long.
    assert (found, len(wanted)) == ((True, 139) if there else (False, 500))
    assert cycle.reading[:4] == reading


def test_the_spring_of_a_travel_is_damped():
    moving = JoystickReading(0.0, 0.0, 0.05, -0.1)
    _, wanted = play(begun(travel, 0.0, 0.0, patience_ns=10 * MS), lambda *_: moving)
    assert wanted[5][:2] == pytest.approx((-1.0, 2.0))


@pytest.mark.parametrize("direction", [(1, 0), (-1, 0), (0, 1), (0, -1)])
def test_a_push_ends_where_the_handle_stands_and_holds_the_other_axis(direction):
    x, y = direction
    (_, end), wanted = play(begun(push_to_stop, direction, force_n=5.0), stuck)
    # The handle may take 80 ms to begin, and must then stand for 40 ms.
    assert len(wanted) == 120 and end == REST
    assert wanted[0][:2] == pytest.approx((5.0 * x, 5.0 * y))
    # At 0.1 m/s of 0.25 m/s the damper takes 2 N; the other axis strays by 4 mm.
    moved = JoystickReading(0.004 * y, 0.004 * x, 0.1 * x, 0.1 * y)
    answers = [REST] * 2 + [moved] * 5000
    (_, end), wanted = play(begun(push_to_stop, direction, force_n=5.0), lambda ms, _: answers[ms])
    assert len(wanted) == 2000 and end == moved
    assert wanted[2][:2] == pytest.approx((3.0 * x - 1.2 * y, 3.0 * y - 1.2 * x))
    # A hand that pushes it off aside meets no more than the whole force.
    far = [REST] * 2 + [JoystickReading(0.05 * abs(y), 0.05 * abs(x), 0.0, 0.0)] * 500
    _, wanted = play(begun(push_to_stop, direction, force_n=5.0), lambda ms, _: far[ms])
    assert hypot(*wanted[2][:2]) == pytest.approx(5.0)


def test_an_aborted_script_has_no_result():
    run = ScriptRun(begun(push_to_stop, (1.0, 0.0), force_n=5.0))
    run.handle_reading(REST, 0)
    assert run.handle_reading(REST, MS) != IDLE
    run.abort()
    assert run.result is None and run.handle_reading(REST, 2 * MS) == IDLE


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize(("motors", "offset_m"), [(1.0, 0.0), (0.8, 0.002)])
def test_stiffness_is_that_which_swings_the_handle(axis, motors, offset_m):
    """The handle that is let go 30 mm aside swings as k, m and its viscous friction say."""
    facts = replace(FACTS, mass_kg=0.5, viscous_n_s_m=2.0)
    # Both in the moved axis; the script's own cycle begins once the travel rests there.
    decay, swings = 2.0 / (2 * 0.5), []

    def answer(ms, output):
        place, speed = 0.03, 0.0
        if ms >= 400:
            omega = (200.0 * motors / 0.5 - decay**2) ** 0.5
            t = (ms - 400) / 1000.0
            place = 0.028 * sin(pi / 2 + omega * t) * 2.718281828 ** (-decay * t) + offset_m
            speed = -0.028 * omega * sin(omega * t) * 2.718281828 ** (-decay * t)
            swings.append((place, output))
        both = [0.0, 0.0, 0.0, 0.0]
        both[axis], both[2 + axis] = place, speed
        return JoystickReading(*both)

    (_, figures), _ = play(begun(stiffness_figures, facts, axis), answer)
    stiffness, rest = figures
    assert (stiffness.name, rest.name) == (f"stiffness {'xy'[axis]}", f"rest {'xy'[axis]}")
    assert stiffness.value == pytest.approx(200.0 * motors, rel=0.01)
    assert stiffness.passed is (motors == 1.0)
    assert rest.unit == "mm" and abs(rest.value - offset_m * 1e3) < 4.0
    assert (rest.least, rest.most) == (-rest.most, pytest.approx(1.6 * facts.coulomb_n * 5 + 1))
    # While it swings, the motors are a spring of 200 N/m along the axis alone.
    place, output = swings[101][0], swings[102][1]
    assert output[axis] == pytest.approx(-200.0 * place) or output[axis] == pytest.approx(
        -200.0 * swings[101][0]
    )
    assert output[1 - axis] == 0.0


class Person:
    """Presses what the LEDs and prompts ask for, a while later; `ignores` some of it."""

    def __init__(self, ignores=(), also=0):
        self.ignores, self.also = ignores, also
        self.prompts, self.leds = [], {}
        self.pressed, self.dead_man = 0, False

    def __call__(self, ms, output):
        words = output.prompt
        if words and words not in self.prompts:
            self.prompts.append(words)
            self.leds[words] = output.leds
        if not any(ignored in words for ignored in self.ignores):
            if words.startswith("press button"):
                self.pressed = 1 << int(words[-1]) - 1 | self.also
            elif words.startswith("let go of button"):
                self.pressed = 0
            elif "dead-man" in words:
                self.dead_man = not words.startswith("let go")
        return REST._replace(buttons=self.pressed, dead_man=self.dead_man)


def test_each_button_is_asked_for_by_its_own_led():
    person = Person()
    result, _ = play(buttons_check(STICK), person)
    assert result.passed and len(result.figures) == 7
    # It has two LEDs and three buttons; all LEDs ask for the dead-man button.
    assert person.leds == {
        "press button 1": 1,
        "let go of button 1": 0,
        "press button 2": 2,
        "let go of button 2": 0,
        "press button 3": 0,
        "let go of button 3": 0,
        "press the dead-man button": 3,
        "let go of the dead-man button": 0,
    }


@pytest.mark.parametrize(
    ("ignores", "also", "failed", "lasts_ms"),
    [
        (("press button 2",), 0, ["button 2 pressed and let go"], 4000),
        (("go of button 2",), 0, ["button 2 pressed and let go", "other buttons with 3"], 4000),
        ((), 8, ["other buttons with 1", "other buttons with 2", "other buttons with 3"], 0),
        (("dead-man",), 0, ["dead-man button let go and pressed"], 4000),
        (("go of the dead-man",), 0, ["dead-man button let go and pressed"], 4000),
    ],
)
def test_a_button_that_does_not_answer_in_four_seconds_fails(ignores, also, failed, lasts_ms):
    result, wanted = play(buttons_check(STICK), Person(ignores, also))
    assert [figure.name for figure in result.figures if not figure.passed] == failed
    assert lasts_ms <= len(wanted) <= lasts_ms + 20


def edge(ms, share=1.0):
    """A stick that is moved round once in two seconds."""
    at = 2 * pi * ms / 2000
    return REST._replace(x_m=0.1 * share * sin(at), y_m=0.08 * share * sin(at + 1), dead_man=True)


def test_a_stick_without_motors_is_moved_by_the_person():
    result, wanted = play(workspace_check(STICK), lambda ms, _: edge(ms))
    assert result.passed and len(wanted) < 2000 and not any(one.x_n or one.y_n for one in wanted)
    assert {one.prompt for one in wanted[1:]} == {"move the stick once round, along its edge"}
    found = {figure.name: (figure.least, figure.most) for figure in result.figures}
    assert found == {
        "left end": (90.0, None),
        "right end": (90.0, None),
        "lower end": (72.0, None),
        "upper end": (72.0, None),
    }
    # Half the way is not enough, however long it lasts.
    result, wanted = play(workspace_check(STICK), lambda ms, _: edge(ms, 0.5))
    assert len(wanted) == 15_000 and not any(figure.passed for figure in result.figures)
    assert [figure.value for figure in result.figures] == pytest.approx([50, 50, 40, 40], rel=1e-3)


@pytest.mark.parametrize("check", [friction_check, spring_check])
def test_a_check_of_motors_is_skipped_without_any(check):
    result, wanted = play(check(STICK), stuck)
    assert "no motors" in result.skipped and not result.passed and not result.failed
    assert wanted == []


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


@pytest.mark.parametrize(("after_ms", "figures"), [(0, 0), (500, 4)])
def test_a_dead_man_button_that_stays_pressed_fails_the_test(after_ms, figures):
    person = Person()
    person.dead_man = after_ms == 0

    def answer(ms, output):
        if not person.dead_man or person.ignores:
            reading = person(ms, output)
        else:
            person.ignores = ("let go",)
            reading = person(ms, output)
        x_m, y_m = edge(ms)[:2]
        return reading._replace(x_m=x_m, y_m=y_m)

    report, wanted = play(functional_test(STICK), answer)
    assert (report.outcome, report.part) == (Outcome.FAILED, TestPart.DEAD_MAN)
    assert report.reason == "the dead-man button was not let go"
    assert len(report.figures) == figures and len(wanted) >= 10_000


def test_a_stick_is_calibrated_where_it_rests():
    quiet = [0.001 * (-1) ** ms for ms in range(400)]

    def answer(ms, output):
        return REST._replace(x_m=0.004 + quiet[ms], y_m=-0.006)

    found, wanted = play(calibrate(STICK), answer)
    assert found.problem == "" and len(wanted) == 300
    assert found[:4] == pytest.approx((0.004, -0.006, 0.1, 0.08), abs=1e-5)
    assert wanted[1].prompt == "leave the stick alone"


@pytest.mark.parametrize(
    ("place", "axis", "problem"),
    [
        # It rests within 15 % of its travel, and moves by at most 5 %.
        (lambda ms: 0.0149, 0, False),
        (lambda ms: -0.0151, 0, True),
        (lambda ms: 0.0119, 1, False),
        (lambda ms: 0.0121, 1, True),
        (lambda ms: 0.0049 * (ms % 2), 0, False),
        (lambda ms: 0.0051 * (ms % 2), 0, True),
        (lambda ms: -0.0041 * (ms % 2), 1, True),
    ],
)
def test_a_stick_that_is_held_is_not_calibrated(place, axis, problem):
    found, _ = play(
        calibrate(STICK), lambda ms, _: REST._replace(**{("x_m", "y_m")[axis]: place(ms)})
    )
    assert ("does not rest at its middle" in found.problem) is problem


def test_a_calibration_finds_the_middle_between_the_stops_and_refuses_a_wrong_width():
    def handle(left, right, low, high):
        at = {"x": 0.0, "y": 0.0}

        def answer(ms, output):
            # A handle so light that it is where it is pushed to; it creeps at 1 mm per ms and N.
            at["x"] = max(left, min(right, at["x"] + 1e-4 * output.x_n))
            at["y"] = max(low, min(high, at["y"] + 1e-4 * output.y_n))
            return REST._replace(x_m=at["x"], y_m=at["y"])

        return answer

    facts = replace(FACTS, half_width_m=0.01, half_height_m=0.02)
    found, _ = play(calibrate(facts), handle(-0.004, 0.016, -0.03, 0.01))
    assert found == (pytest.approx(0.006), pytest.approx(-0.01), 0.01, 0.02, "")
    found, _ = play(calibrate(facts), handle(-0.004, 0.0145, -0.03, 0.01))
    assert found.problem == "" and found.half_width_m == pytest.approx(0.00925)
    found, _ = play(calibrate(facts), handle(-0.004, 0.0142, -0.03, 0.01))
    assert "axis x moves by ±9 mm where ±10 mm are due" in found.problem
    found, _ = play(calibrate(facts), handle(-0.004, 0.016, -0.03, 0.0135))
    assert "axis y moves by ±22 mm where ±20 mm are due" in found.problem


@pytest.mark.parametrize(
    ("value", "least", "most", "passed"),
    [
        (5.0, 5.0, 5.0, True),
        (4.9, 5.0, None, False),
        (5.1, None, 5.0, False),
        (5.1, 5.0, None, True),
        (4.9, None, 5.0, True),
        (None, None, None, True),
        (None, 1.0, None, False),
        (None, None, 1.0, False),
    ],
)
def test_a_figure_passes_within_its_limits_and_a_check_with_all_figures(value, least, most, passed):
    figure, good = Figure("one", value, "N", least, most), Figure("two", 1.0)
    assert figure.passed is passed
    result = CheckResult("check", (good, figure))
    assert (result.passed, result.failed) == (passed, not passed)
    assert CheckResult("check", (good, figure), trouble="smoke").failed
    skipped = CheckResult("check", (good, figure), skipped="no motors")
    assert not skipped.passed and not skipped.failed


def test_a_device_that_never_becomes_ready_fails_each_check_after_forty_seconds():
    """Here nobody lets go of the stick, which would be calibrated again and again."""
    device = SimulatedDevice()
    device.facts = STICK
    device.read = lambda: REST._replace(x_m=0.05)
    bench = CheckBench(device, ["workspace", "buttons"])
    assert (bench.done, bench.current) == (False, "workspace")
    for ms in range(0, 40_001, 20):
        bench.handle_cycle(ms * MS, MS)
    assert not bench.results
    bench.handle_cycle(40_020 * MS, MS)
    assert [result.name for result in bench.results] == ["workspace", "buttons"]
    assert all("does not rest at its middle" in result.trouble for result in bench.results)
    assert bench.done and bench.current == bench.prompt == ""

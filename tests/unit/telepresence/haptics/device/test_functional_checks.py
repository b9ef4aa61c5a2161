"""The checks of workspace, friction, spring and buttons, against sensors that are made up."""

from dataclasses import replace
from math import exp, pi, sin

import pytest
from joystick_scripts import STICK, Person, begun, edge, play, stuck

from telepresence.haptics.device.device import JoystickReading
from telepresence.haptics.device.functional_checks import (
    buttons_check,
    friction_check,
    spring_check,
    stiffness_metrics,
    workspace_check,
)
from telepresence.haptics.device.simulated import CAPABILITIES


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize(
    ("motors", "offset_m", "turns"), [(1.0, 0.0, 99), (0.8, 0.002, 99), (1.0, 0.0, 2)]
)
def test_stiffness_is_that_which_swings_the_handle(axis, motors, offset_m, turns):
    """The handle that is let go 30 mm aside swings as k, m and its viscous friction say."""
    capabilities = replace(CAPABILITIES, mass_kg=0.5, viscous_n_s_m=2.0)
    decay, swings = 2.0 / (2 * 0.5), []
    omega = (200.0 * motors / 0.5 - decay**2) ** 0.5

    def answer(ms, output):
        position, speed = 0.03, 0.0
        if ms >= 400:
            t = (ms - 400) / 1000.0
            position = 0.028 * sin(pi / 2 + omega * t) * exp(-decay * t) + offset_m
            speed = -0.028 * omega * sin(omega * t) * exp(-decay * t)
            speed *= omega * t < (turns + 0.5) * pi
            swings.append((position, output))
        both = [0.0, 0.0, 0.0, 0.0]
        both[axis], both[2 + axis] = position, speed
        return JoystickReading(*both)

    (_, (stiffness, rest)), _ = play(begun(stiffness_metrics, capabilities, axis), answer)
    assert (stiffness.name, rest.name) == (f"stiffness {'xy'[axis]}", f"rest {'xy'[axis]}")
    assert stiffness.value == pytest.approx(200.0 * motors, rel=0.01)
    assert stiffness.passed is (motors == 1.0)
    assert rest.unit == "mm" and abs(rest.value - offset_m * 1e3) < 4.0
    assert (rest.least, rest.most) == (
        -rest.most,
        pytest.approx(1.6 * capabilities.coulomb_n * 5 + 1),
    )
    # While it swings, the motors are a spring of 200 N/m along the axis alone.
    output = swings[102][1]
    assert output[axis] == pytest.approx(-200.0 * swings[101][0]) and output[1 - axis] == 0.0


def test_each_button_is_asked_for_by_its_own_led():
    person = Person()
    result, _ = play(buttons_check(STICK), person)
    assert result.passed and len(result.metrics) == 7
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
    assert [figure.name for figure in result.metrics if not figure.passed] == failed
    assert lasts_ms <= len(wanted) <= lasts_ms + 20


def test_a_stick_without_motors_is_moved_by_the_person():
    result, wanted = play(workspace_check(STICK), lambda ms, _: edge(ms))
    assert result.passed and len(wanted) < 2000 and not any(one.x_n or one.y_n for one in wanted)
    assert {one.prompt for one in wanted[1:]} == {"move the stick once round, along its edge"}
    found = {figure.name: (figure.least, figure.most) for figure in result.metrics}
    assert found == {
        "left end": (90.0, None),
        "right end": (90.0, None),
        "lower end": (72.0, None),
        "upper end": (72.0, None),
    }
    # Half the way is not enough, however long it lasts.
    result, wanted = play(workspace_check(STICK), lambda ms, _: edge(ms, 0.5))
    assert len(wanted) == 15_000 and not any(figure.passed for figure in result.metrics)
    assert [figure.value for figure in result.metrics] == pytest.approx([50, 50, 40, 40], rel=1e-3)


@pytest.mark.parametrize("check", [friction_check, spring_check])
def test_a_check_of_motors_is_skipped_without_any(check):
    result, wanted = play(check(STICK), stuck)
    assert "no motors" in result.skipped and not result.passed and not result.failed
    assert wanted == []

"""The parts of scripts that move a handle: travel, push to a stop, figures with limits."""

from itertools import pairwise
from math import hypot

import pytest
from joystick_scripts import MS, REST, begun, play, stuck

from telepresence.haptics.device.device import JoystickReading
from telepresence.haptics.device.script import (
    IDLE,
    CheckResult,
    Figure,
    ScriptRun,
    push_to_stop,
    travel,
)


def sizes(wanted):
    return [hypot(one.x_n, one.y_n) for one in wanted]


def test_a_travel_leads_along_its_way_and_then_overcomes_friction_slowly():
    (_, there), wanted = play(begun(travel, 0.03, 0.04), stuck)
    # It gives up after 3 s.
    assert not there and len(wanted) == 3000
    forces = sizes(wanted)
    assert forces[0] == 0.0 and all(b > a for a, b in pairwise(forces))
    # It leads straight to the goal; then each axis is pushed by as much more.
    assert all(one.y_n == pytest.approx(4 / 3 * one.x_n) for one in wanted[:334])
    assert forces[333] == pytest.approx(300.0 * 0.05, rel=0.01)
    assert {round(one.y_n - one.x_n, 6) for one in wanted[340:]} == {3.0}
    assert wanted[2999].x_n - wanted[1999].x_n == pytest.approx(10.0)
    _, wanted = play(begun(travel, -0.03, -0.04, force_n=8.0, timeout_ns=1000 * MS), stuck)
    assert max(sizes(wanted)) == pytest.approx(8.0)
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

    (cycle, found), wanted = play(begun(travel, 0.05, 0.03, timeout_ns=500 * MS), answer)
    # Rest is 40 ms long.
    assert (found, len(wanted)) == ((True, 139) if there else (False, 500))
    assert cycle.reading[:4] == reading


def test_the_spring_of_a_travel_is_damped():
    moving = JoystickReading(0.0, 0.0, 0.05, -0.1)
    _, wanted = play(begun(travel, 0.0, 0.0, timeout_ns=10 * MS), lambda *_: moving)
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
def test_a_figure_passes_within_its_limits_and_a_check_with_all_metrics(value, least, most, passed):
    figure, good = Figure("one", value, "N", least, most), Figure("two", 1.0)
    assert figure.passed is passed
    result = CheckResult("check", (good, figure))
    assert (result.passed, result.failed) == (passed, not passed)
    assert CheckResult("check", (good, figure), trouble="smoke").failed
    skipped = CheckResult("check", (good, figure), skipped="no motors")
    assert not skipped.passed and not skipped.failed

"""FunctionalTest: the joystick tests itself within a session, while it leads no robot.

A person lets the dead-man button go, then holds it. While it is held, the motors move each axis
aside and back, display a spring, push to the ends of the workspace and move at two speeds. Then
each LED asks for its button. A person moves a device without motors. The motors never push without
the dead-man button, and never with more than `FORCE_N`.
"""

from enum import StrEnum
from typing import NamedTuple, TypeVar

from kontur_av.clock import NS_PER_S
from telepresence.haptics.device.device import JoystickCapabilities
from telepresence.haptics.device.functional_checks import (
    each_button,
    friction_check,
    stiffness_metrics,
    workspace_check,
)
from telepresence.haptics.device.script import (
    IDLE,
    CheckResult,
    CheckScript,
    Cycle,
    Figure,
    Output,
    Script,
    travel,
)

NAME = "functional test"
#: The largest force per axis; the spring needs 6 N. Chosen.
FORCE_N = 6.5
#: Where each axis is moved to (m), within the workspace of every joystick here. Chosen.
ASIDE_M = 0.03
#: The largest force while an axis is moved aside (N): a hand holds it back easily.
_MOVE_N = 4.0
#: Time that a person has to press or let go.
TIMEOUT_NS = 10 * NS_PER_S

_Result = TypeVar("_Result")


class Outcome(StrEnum):
    """What became of the newest test."""

    NONE = "none"
    RUNNING = "running"
    PASSED = "passed"
    FAILED = "failed"
    ABORTED = "aborted"


class TestPart(StrEnum):
    """The part that a failed or aborted test was about."""

    #: pytest takes a class of such a name for tests.
    __test__ = False

    NONE = "none"
    DEAD_MAN = "dead-man button"
    PLACE = "place"
    FORCE = "force"
    FRICTION = "friction"
    BUTTONS = "buttons"


#: By the unit of a figure: the part that it is of.
_PARTS = {
    "mm": TestPart.PLACE,
    "N/m": TestPart.FORCE,
    "N": TestPart.FRICTION,
    "N s/m": TestPart.FRICTION,
    "": TestPart.BUTTONS,
}


class TestReport(NamedTuple):
    """The newest test. reason: one line, "" if it passed or runs. number: how many have begun.

    metrics: what was measured, with limits.
    """

    outcome: Outcome = Outcome.NONE
    part: TestPart = TestPart.NONE
    reason: str = ""
    number: int = 0
    metrics: tuple[Figure, ...] = ()


def functional_test(capabilities: JoystickCapabilities) -> Script[TestReport]:
    """Return the script: about 35 s with motors, and what the person takes. `number` is 0."""
    cycle: Cycle = yield IDLE
    leds = (1 << capabilities.leds) - 1
    released = Output(prompt="let go of the dead-man button")
    cycle, there = yield from _await_dead_man(cycle, released, wanted=False)
    if not there:
        return TestReport(Outcome.FAILED, TestPart.DEAD_MAN, "the dead-man button was not let go")
    held = Output(leds=leds, prompt="press and hold the dead-man button, hold the handle loosely")
    cycle, there = yield from _await_dead_man(cycle, held, wanted=True)
    if not there:
        return TestReport(Outcome.FAILED, TestPart.DEAD_MAN, "the dead-man button was not pressed")
    if capabilities.has_force:
        result = yield from _while_held(_with_motors(capabilities), held)
    else:
        asked = held._replace(prompt="hold the dead-man button, and move the stick along its edge")
        result = yield from _while_held(workspace_check(capabilities), asked)
    if result is None:
        return TestReport(Outcome.ABORTED, TestPart.DEAD_MAN, "the dead-man button was let go")
    cycle = yield released
    cycle, there = yield from _await_dead_man(cycle, released, wanted=False)
    found = result.metrics
    if there and not result.trouble:
        cycle, pressed = yield from each_button(cycle, capabilities)
        found += tuple(pressed)
    if bad := [figure for figure in found if not figure.passed]:
        figure = bad[0]
        return TestReport(Outcome.FAILED, _PARTS[figure.unit], _words(figure), metrics=found)
    if result.trouble:
        return TestReport(Outcome.FAILED, TestPart.PLACE, result.trouble, metrics=found)
    if not there:
        reason = "the dead-man button was not let go"
        return TestReport(Outcome.FAILED, TestPart.DEAD_MAN, reason, metrics=found)
    return TestReport(Outcome.PASSED, metrics=found)


def _with_motors(capabilities: JoystickCapabilities) -> CheckScript:
    cycle: Cycle = yield IDLE
    metrics: list[Figure] = []
    for axis in (0, 1):
        for aside_m in (ASIDE_M, -ASIDE_M, 0.0):
            goal = (aside_m, 0.0) if axis == 0 else (0.0, aside_m)
            moved = _said(travel(cycle, *goal, force_n=_MOVE_N), f"{2 * axis + 1} of 6, place")
            cycle, there = yield from moved
            if not there:
                away_x, away_y = goal[0] - cycle.reading.x_m, goal[1] - cycle.reading.y_m
                stuck = "x" if abs(away_x) > abs(away_y) else "y"
                trouble = f"axis {stuck} does not move to where it is pushed"
                return CheckResult(NAME, tuple(metrics), trouble)
        spring = stiffness_metrics(cycle, capabilities, axis)
        cycle, found = yield from _said(spring, f"{2 * axis + 2} of 6, spring")
        if found is None:
            trouble = f"axis {'xy'[axis]} does not move to where it is pushed"
            return CheckResult(NAME, tuple(metrics), trouble)
        metrics += found
    for check, part in (
        (workspace_check, "5 of 6, workspace"),
        (friction_check, "6 of 6, friction"),
    ):
        found_more = yield from _said(check(capabilities), part)
        metrics += found_more.metrics
        if found_more.trouble:
            return CheckResult(NAME, tuple(metrics), found_more.trouble)
    return CheckResult(NAME, tuple(metrics))


def _await_dead_man(cycle: Cycle, output: Output, *, wanted: bool) -> Script[tuple[Cycle, bool]]:
    until_ns = cycle.now_ns + TIMEOUT_NS
    while cycle.reading.dead_man is not wanted:
        if cycle.now_ns >= until_ns:
            return cycle, False
        cycle = yield output
    return cycle, True


def _said(script: Script[_Result], part: str) -> Script[_Result]:
    """Run a script of the motors, and say which part it is."""
    prompt = f"keep the button held: the motors move the handle (part {part})"
    try:
        output = next(script)
        while True:
            output = script.send((yield output._replace(prompt=prompt)))
    except StopIteration as end:
        result: _Result = end.value
        return result


def _while_held(script: Script[_Result], shown: Output) -> Script[_Result | None]:
    """Run a script with the LEDs and the prompt of `shown`; None once the button is let go."""
    try:
        output = next(script)
        while True:
            prompt = output.prompt or shown.prompt
            cycle = yield shown._replace(x_n=_cut(output.x_n), y_n=_cut(output.y_n), prompt=prompt)
            if not cycle.reading.dead_man:
                script.close()
                return None
            output = script.send(cycle)
    except StopIteration as end:
        result: _Result = end.value
        return result


def _cut(force_n: float) -> float:
    return max(-FORCE_N, min(FORCE_N, force_n))


def _words(figure: Figure) -> str:
    value = "nothing" if figure.value is None else f"{figure.value:.4g} {figure.unit}"
    least, most = figure.least, figure.most
    due = f"{least:g} to {most:g}"
    if least is None or most is None:
        due = f"at least {least:g}" if most is None else f"at most {most:g}"
    return f"{figure.name}: {value}, {due} {figure.unit} is due"

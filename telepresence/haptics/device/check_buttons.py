"""Buttons and LEDs: each LED lights up to ask a person to press and release its button.

Without LEDs the prompt asks in words. The dead-man button comes last. It must be seen released and
pressed; all LEDs together ask for a press.
"""

from kontur_av.clock import NS_PER_S
from telepresence.haptics.device.check import CheckResult, CheckScript, Figure
from telepresence.haptics.device.device import JoystickFacts
from telepresence.haptics.device.script import IDLE, Cycle, Output, Script

NAME = "buttons"

#: Time that a person has for each press and for each release.
PATIENCE_NS = 4 * NS_PER_S


def buttons_check(facts: JoystickFacts) -> CheckScript:
    """Return the script; its duration depends on the person, at most 8 s a button."""
    cycle: Cycle = yield IDLE
    cycle, figures = yield from each_button(cycle, facts)
    all_leds = (1 << facts.leds) - 1
    seen = 0
    # Begin with the opposite of the present state, so that both states are seen.
    for wanted_on in (False, True) if cycle.reading.dead_man else (True, False, True):
        words = "press the dead-man button" if wanted_on else "let go of the dead-man button"
        output = Output(leds=all_leds if wanted_on else 0, prompt=words)
        cycle, came = yield from _await_dead_man(cycle, output, wanted_on)
        if not came:
            break
        seen |= 1 << wanted_on
    figures.append(Figure("dead-man button let go and pressed", float(seen == 3), "", 1, 1))
    return CheckResult(NAME, tuple(figures))


def each_button(cycle: Cycle, facts: JoystickFacts) -> Script[tuple[Cycle, list[Figure]]]:
    """Ask for each button but the dead-man button; return two figures of each."""
    figures: list[Figure] = []
    for index in range(facts.buttons):
        bit = 1 << index
        leds = bit if index < facts.leds else 0
        pressed, wrong = False, 0
        for wanted in (bit, 0):
            words = f"press button {index + 1}" if wanted else f"let go of button {index + 1}"
            # The LED goes out with the press, which shows the person that it was noticed.
            output = Output(leds=leds if wanted else 0, prompt=words)
            cycle, came, others = yield from _await_buttons(cycle, output, bit, wanted)
            wrong |= others
            if not came:
                break
            pressed = not wanted
        figures += [
            Figure(f"button {index + 1} pressed and let go", float(pressed), "", 1, 1),
            Figure(f"other buttons with {index + 1}", float(wrong.bit_count()), "", 0, 0),
        ]
    return cycle, figures


def _await_buttons(
    cycle: Cycle, output: Output, bit: int, wanted: int
) -> Script[tuple[Cycle, bool, int]]:
    others = 0
    until_ns = cycle.now_ns + PATIENCE_NS
    while cycle.now_ns < until_ns:
        others |= cycle.reading.buttons & ~bit
        if cycle.reading.buttons & bit == wanted:
            return cycle, True, others
        cycle = yield output
    return cycle, False, others


def _await_dead_man(cycle: Cycle, output: Output, wanted: bool) -> Script[tuple[Cycle, bool]]:
    until_ns = cycle.now_ns + PATIENCE_NS
    while cycle.now_ns < until_ns:
        if cycle.reading.dead_man == wanted:
            return cycle, True
        cycle = yield output
    return cycle, False

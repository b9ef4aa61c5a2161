"""Scripts that move a handle, played against sensors that a test makes up."""

from math import pi, sin

from telepresence.haptics.device.device import JoystickCapabilities, JoystickReading
from telepresence.haptics.device.script import IDLE, ScriptRun

MS = 1_000_000
REST = JoystickReading(0.0, 0.0, 0.0, 0.0, dead_man=False)
STICK = JoystickCapabilities(name="stick", half_width_m=0.1, half_height_m=0.08, buttons=3, leds=2)


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


def operated(operation, milliseconds, now_ns=0):
    """Operate a joystick without force for so long; return the instant."""
    for _ in range(milliseconds):
        now_ns += MS
        operation.handle_reading(now_ns)
        operation.handle_force(0.0, 0.0)
        operation.device.advance(MS)
    return now_ns


def begun(function, *arguments, **options):
    """A script that is handed its first cycle."""
    cycle = yield IDLE
    return (yield from function(cycle, *arguments, **options))


def stuck(ms, output):
    return REST


def edge(ms, share=1.0):
    """A stick that is moved round once in two seconds."""
    at = 2 * pi * ms / 2000
    return REST._replace(x_m=0.1 * share * sin(at), y_m=0.08 * share * sin(at + 1), dead_man=True)


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

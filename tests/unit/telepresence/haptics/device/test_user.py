"""A user's joystick: what its driver raises or returns is an error of the joystick."""

import numpy as np
import pytest

from kontur_av.clock import NS_PER_MS as MS
from kontur_av.returned import PartError
from telepresence.haptics.device.device import JoystickCapabilities, JoystickReading
from telepresence.haptics.device.handle import OperatedHandle
from telepresence.haptics.device.states import JoystickState
from telepresence.haptics.device.user import UserJoystick


class Stick:
    """A joystick without motors. `fails`: the call that raises."""

    capabilities = JoystickCapabilities(name="stick", half_width_m=0.1, half_height_m=0.1)
    fails = ""
    reading = JoystickReading(0.0, 0.0, 0.0, 0.0)

    def __getattr__(self, name):
        def call(*_):
            if name == self.fails:
                raise OSError("E217: no answer\nof the drive")
            return self.reading if name == "read" else None

        return call


def run(handle, cycles):
    for _ in range(cycles):
        handle.step(0.0, 0.0, MS)


@pytest.mark.parametrize("fails", ["read", "write_force", "advance"])
def test_what_a_driver_raises_is_the_joysticks_error_until_it_is_over(fails):
    stick = Stick()
    handle = OperatedHandle(UserJoystick(stick))
    run(handle, 500)
    assert handle.operation.state is JoystickState.APPLICATION
    stick.fails = fails
    run(handle, 20)
    assert handle.operation.state is JoystickState.RECOVERABLE
    assert handle.operation.reason == f"{fails}() failed: OSError: E217: no answer of the drive"
    stick.fails = ""
    run(handle, 3000)
    assert handle.operation.state is JoystickState.APPLICATION


def test_its_own_words_its_numbers_and_its_silence_about_the_dead_man_are_taken():
    stick = Stick()
    handle = OperatedHandle(UserJoystick(stick))
    stick.reading = (np.float32(0.01), np.zeros(1), 0, 0)
    run(handle, 500)
    assert handle.operation.state is JoystickState.APPLICATION
    assert not handle.dead_man
    stick.reading = JoystickReading(0.0, 0.0, 0.0, 0.0, error="E217: gripper jammed")
    run(handle, 20)
    assert handle.operation.reason == "E217: gripper jammed"
    stick.reading = "nonsense"
    assert "give a JoystickReading" in UserJoystick(stick).read().error


def test_facts_that_cannot_be_are_refused():
    stick = Stick()
    stick.capabilities = {"name": "stick"}
    with pytest.raises(PartError, match="capabilities returned a dict: give JoystickCapabilities"):
        UserJoystick(stick)

"""The door for what a user's part returns: it is converted, or refused in one line."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kontur_av.returned import PartError, one_line, taken
from telepresence import JoystickCapabilities, JoystickReading, RobotCapabilities, RobotReading

KINDS = (RobotReading, JoystickReading, RobotCapabilities, JoystickCapabilities)
REST = (0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("number", [np.float64, np.float32, np.int16, lambda one: np.array([one])])
def test_numbers_of_numpy_become_those_of_python(number):
    reading = RobotReading(*map(number, (1, 2, 3, 4)), contact=np.bool_(True), joints=[[1, 2]])
    found = taken(RobotReading, reading, "read()")
    assert found == RobotReading(1.0, 2.0, 3.0, 4.0, contact=True, joints=((1.0, 2.0),))
    assert {type(one) for one in found[:6]} == {float} and type(found.contact) is bool
    capabilities = taken(
        RobotCapabilities, RobotCapabilities(name="arm", speed_m_s=number(1)), "capabilities"
    )
    assert type(capabilities.speed_m_s) is float
    held = taken(JoystickReading, (*REST, np.uint8(3), np.bool_(True), None), "read()")
    assert held == JoystickReading(*REST, 3, True)


@pytest.mark.parametrize(
    ("kind", "value", "said"),
    [
        (RobotReading, None, "returned None: give a RobotReading"),
        (RobotReading, (1.0, 2.0), "give a RobotReading"),
        (RobotReading, ("a", *REST[1:]), "returned x_m = 'a': give a number"),
        (RobotReading, (np.zeros(2), *REST[1:]), "returned x_m = array([0., 0.]): give a number"),
        (RobotReading, RobotReading(*REST, joints=(1, 2)), "joints = 1: give a JointReading"),
        (JoystickReading, (*REST, "no"), "buttons = 'no': give a whole number"),
        (JoystickReading, (*REST, 0, "yes"), "dead_man = 'yes': give True or False"),
        (RobotCapabilities, {"name": "arm"}, "a dict: give RobotCapabilities"),
        (
            RobotCapabilities,
            RobotCapabilities(name="arm", takes="torque"),
            "'torque': one of force, position",
        ),
        (
            RobotCapabilities,
            RobotCapabilities(name="arm", speed_m_s=0.0),
            "0.0: give a number above 0",
        ),
        (
            JoystickCapabilities,
            JoystickCapabilities(name="", half_width_m=1, half_height_m=1),
            "give a text",
        ),
    ],
)
def test_what_cannot_be_is_refused_in_one_line_that_names_it(kind, value, said):
    with pytest.raises(PartError) as refused:
        taken(kind, value, "read()")
    assert said in str(refused.value)


def test_words_of_a_part_are_one_line_that_a_terminal_can_show():
    reading = RobotReading(*REST, error="\x1b[2JE217:\r\n gripper  jammed\0")
    assert taken(RobotReading, reading, "read()").error == "?[2JE217: gripper jammed?"
    assert len(one_line("x" * 1000)) == 200


class Odd:
    """Raises whatever is asked of it."""

    def __getattr__(self, name):
        raise RuntimeError(name)

    def __repr__(self):
        raise RuntimeError

    __float__ = __iter__ = __index__ = __bool__ = __eq__ = __hash__ = __repr__


VALUES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text() | st.builds(Odd),
    lambda inner: st.lists(inner, max_size=10) | st.dictionaries(st.text(), inner, max_size=2),
    max_leaves=20,
)


@given(kind=st.sampled_from(KINDS), value=VALUES)
def test_nothing_comes_through_the_door_but_the_kind_or_one_line(kind, value):
    try:
        assert type(taken(kind, value, "read()")) is kind
    except PartError as refused:
        assert "\n" not in str(refused)

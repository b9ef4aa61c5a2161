"""The 12-octet sample, octet by octet: computed by hand from the table in sample.py."""

import pytest
from haptic_samples import unpack_command, unpack_feedback

from telepresence.haptics.axes import pack_axes, read_axes
from telepresence.haptics.sample import (
    FLAG_CONTACT,
    FLAG_DEAD_MAN,
    FLAG_FEEDBACK,
    POSITION_M,
    Command,
    Feedback,
    Greeting,
    is_greeting,
    pack_command,
    pack_feedback,
    pack_greeting,
    read_greeting,
)

# Dead-man button 0x10; state 3 with the buttons 0 and 2 (0b0101): 0x53.
# 0.06 m = 3000 counts = 0x0BB8; -0.05 m = -2500 = 0xF63C; session 7; 6016277 µJ = 0x5BCD15.
COMMAND = bytes.fromhex("1234 10 53 0bb8 f63c 07 5bcd15")
# Feedback 0x80 and contact 0x01; impedance 3 with LED 2 lit: (2 + 1) << 4 | 3 = 0x33.
# -7 N = -3500 counts = 0xF254; 0.5 N = 250 = 0x00FA; the last session, the most energy.
FEEDBACK = bytes.fromhex("ffff 81 33 f254 00fa ff ffffff")
# Request 0x00c0ffee of a joystick that sends in session 5 and has heard of the life 0xbee100. It
# holds.
REQUEST = bytes.fromhex("0005 44 00 00c0ffee 00bee100")
# The robot's life 0xbeef00 offers session 6 for it.
OFFER = bytes.fromhex("0006 c0 00 00beef00 00c0ffee")


def test_command_golden():
    value = Command(0.06, -0.05, 6_016_277, buttons=0b0101)
    assert pack_command(0x1234, value, session=7) == COMMAND
    session, sequence, flags, command = unpack_command(COMMAND)
    assert (session, sequence, flags) == (7, 0x1234, FLAG_DEAD_MAN)
    assert command[:-1] == pytest.approx((0.06, -0.05, 6_016_277, True, 3, 5, *[False] * 4))


def test_feedback_golden():
    value = Feedback(-7.0, 0.5, (1 << 24) - 1, True, lit=2)
    assert pack_feedback(65535, value, session=255) == FEEDBACK
    session, sequence, flags, feedback = unpack_feedback(FEEDBACK)
    assert (session, sequence, flags) == (255, 65535, FLAG_FEEDBACK | FLAG_CONTACT)
    assert feedback[:-1] == pytest.approx((-7.0, 0.5, (1 << 24) - 1, True, 3, 2, *[False] * 4))


@pytest.mark.parametrize(
    ("data", "greeting", "feedback"),
    [
        (REQUEST, Greeting(5, 0xC0FFEE, 0xBEE100), False),
        (OFFER, Greeting(6, 0xBEEF00, 0xC0FFEE), True),
    ],
)
def test_greetings_golden(data, greeting, feedback):
    assert pack_greeting(greeting, feedback=feedback, holding=not feedback) == data
    assert is_greeting(data)
    assert read_greeting(data, feedback=feedback) == greeting
    assert not is_greeting(COMMAND) and not is_greeting(data[:-1])


def test_more_axes_follow_the_twelve_octets():
    # z: 0.05 m = 2500 counts = 0x09C4; 200000 µJ of this session = 0x030D40.
    # yaw: -0.5 rad at a lever of 0.1 m = -2500 = 0xF63C; its controller acted: 0x800000.
    values = [(0.05, 1_200_000, False), (-0.05, 0, True)]
    data = bytes.fromhex("09c4 030d40 f63c 800000")
    assert pack_axes(values, (1_000_000, 0), POSITION_M) == data
    assert read_axes(data, POSITION_M) == [
        (pytest.approx(0.05), 200_000, False),
        (pytest.approx(-0.05), 0, True),
    ]

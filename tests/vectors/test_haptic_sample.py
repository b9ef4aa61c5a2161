"""The 12-octet sample, octet by octet: computed by hand from the table in sample.py."""

import math

import pytest
from haptic_samples import unpack_command, unpack_feedback

from kontur_av.errors import ProtocolError
from telepresence.haptics.axes import pack_axes, read_axes
from telepresence.haptics.sample import (
    FLAG_ACTED,
    FLAG_CONTACT,
    FLAG_DEAD_MAN,
    FLAG_FEEDBACK,
    FLAG_HALTED,
    FLAG_HOLDING,
    FLAG_SATURATED,
    MODE_IMPEDANCE,
    MODE_POSITION,
    POSITION_M,
    STATE_APPLICATION,
    STATE_HALTED,
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


def test_command_golden() -> None:
    value = Command(0.06, -0.05, 6_016_277, buttons=0b0101)
    assert pack_command(0x1234, value, session=7) == COMMAND
    session, sequence, flags, command = unpack_command(COMMAND)
    assert (session, sequence, flags) == (7, 0x1234, FLAG_DEAD_MAN)
    assert command[:-1] == pytest.approx((0.06, -0.05, 6_016_277, True, 3, 5, *[False] * 4))


def test_feedback_golden() -> None:
    value = Feedback(-7.0, 0.5, (1 << 24) - 1, True, lit=2)
    assert pack_feedback(65535, value, session=255) == FEEDBACK
    session, sequence, flags, feedback = unpack_feedback(FEEDBACK)
    assert (session, sequence, flags) == (255, 65535, FLAG_FEEDBACK | FLAG_CONTACT)
    assert feedback[:-1] == pytest.approx((-7.0, 0.5, (1 << 24) - 1, True, 3, 2, *[False] * 4))


def test_greetings_golden() -> None:
    for data, greeting, feedback in (
        (REQUEST, Greeting(5, 0xC0FFEE, 0xBEE100), False),
        (OFFER, Greeting(6, 0xBEEF00, 0xC0FFEE), True),
    ):
        assert pack_greeting(greeting, feedback=feedback, holding=not feedback) == data
        assert is_greeting(data)
        assert read_greeting(data, feedback=feedback) == greeting
        with pytest.raises(ProtocolError):
            read_greeting(data, feedback=not feedback)
        with pytest.raises(ProtocolError):
            (unpack_feedback if feedback else unpack_command)(data)
    assert not is_greeting(COMMAND) and not is_greeting(REQUEST[:-1])
    for wrong in ("0105 40 00 00c0ffee 00000000", "0005 40 01 00c0ffee 00000000"):
        with pytest.raises(ProtocolError):
            read_greeting(bytes.fromhex(wrong), feedback=False)
    with pytest.raises(ProtocolError):
        read_greeting(bytes.fromhex("0005 40 00 00000000 00000000"), feedback=False)


def test_the_energy_of_a_session_saturates_and_never_wraps() -> None:
    most = "0000 10 03 0000 0000 01 ffffff"
    assert pack_command(0, Command(0.0, 0.0, (1 << 32) + 5)) == bytes.fromhex(most)
    data = pack_feedback(0, Feedback(0.0, 0.0, 3 << 32, False), session=2, base_uj=(3 << 32) - 9)
    assert unpack_feedback(data).value.energy_uj == 9


def test_flags_show_the_senders_state() -> None:
    command = Command(0.0, 0.0, 0, False, STATE_HALTED, 0, True, True)
    stopping = Command(0.0, 0.0, 0, True, STATE_APPLICATION, 0, stop=True, blind=True)
    data = pack_command(1, stopping)
    assert data == bytes.fromhex("0001 11 0b 0000 0000 01000000")
    assert unpack_command(data).value == stopping
    data = pack_command(1, command, holding=True)
    assert data == bytes.fromhex("0001 2c 04 0000 0000 01000000")
    assert unpack_command(data).flags == FLAG_HALTED | FLAG_ACTED | FLAG_HOLDING
    assert unpack_command(data).value == command
    held = Feedback(0.0, 0.0, 0, False, MODE_IMPEDANCE, 2, waiting=True, stopped=True)
    data = pack_feedback(1, held)
    assert data == bytes.fromhex("0001 90 3b 0000 0000 01000000")
    assert unpack_feedback(data).value == held
    feedback = Feedback(0.0, 0.0, 0, False, MODE_POSITION, None, True, True)
    data = pack_feedback(1, feedback)
    assert data == bytes.fromhex("0001 a8 02 0000 0000 01000000")
    assert unpack_feedback(data).value == feedback


def test_values_out_of_range_saturate_and_set_a_flag() -> None:
    data = pack_command(0, Command(9.0, -math.inf, 0), holding=True)
    assert data == bytes.fromhex("0000 16 03 7fff 8001 01000000")
    assert unpack_command(data).flags == FLAG_DEAD_MAN | FLAG_SATURATED | FLAG_HOLDING
    data = pack_feedback(65536, Feedback(-1e6, 0.0, 0, False))
    assert data == bytes.fromhex("0000 82 03 8001 0000 01000000")
    data = pack_feedback(0, Feedback(0.0, 65.534, 0, False))
    assert data == bytes.fromhex("0000 80 03 0000 7fff 01000000")


def test_not_a_number_is_refused() -> None:
    with pytest.raises(ValueError):
        pack_command(0, Command(math.nan, 0.0, 0))
    with pytest.raises(ValueError):
        pack_feedback(0, Feedback(0.0, math.nan, 0, False))


@pytest.mark.parametrize(
    "data",
    [
        b"",
        COMMAND[:-1],
        COMMAND + b"\0",
        FEEDBACK,
        bytes.fromhex("0000 10 03 8000 0000 01000000"),
        bytes.fromhex("0000 10 03 0000 0000 00000000"),
    ],
)
def test_an_invalid_command_is_refused(data: bytes) -> None:
    with pytest.raises(ProtocolError):
        unpack_command(data)


@pytest.mark.parametrize(
    "data",
    [
        COMMAND,
        bytes.fromhex("0000 80 03 0000 8000 01000000"),
        bytes.fromhex("0000 80 03 0000 0000 00000000"),
        *(bytes.fromhex(f"0000 80 0{mode:x} 0000 0000 01000000") for mode in (4, 5, 6, 7, 12, 15)),
    ],
)
def test_an_invalid_feedback_is_refused(data: bytes) -> None:
    with pytest.raises(ProtocolError):
        unpack_feedback(data)


def test_a_state_or_a_mode_that_does_not_exist_is_a_bug_of_the_sender() -> None:
    with pytest.raises(ValueError):
        pack_command(0, Command(0.0, 0.0, 0, state=8))
    with pytest.raises(ValueError):
        pack_feedback(0, Feedback(0.0, 0.0, 0, False, mode=4))


def test_more_axes_follow_the_twelve_octets() -> None:
    # z: 0.05 m = 2500 counts = 0x09C4; 200000 µJ of this session = 0x030D40.
    # yaw: -0.5 rad at a lever of 0.1 m = -2500 = 0xF63C; its controller acted: 0x800000.
    values = [(0.05, 1_200_000, False), (-0.05, 0, True)]
    data = bytes.fromhex("09c4 030d40 f63c 800000")
    assert pack_axes(values, (1_000_000, 0), POSITION_M) == data
    assert read_axes(data, POSITION_M) == [
        (pytest.approx(0.05), 200_000, False),
        (pytest.approx(-0.05), 0, True),
    ]

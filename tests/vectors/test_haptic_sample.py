"""The 12-octet sample, octet by octet: computed by hand from the table in sample.py."""

import math

import pytest

from kontur_av.errors import ProtocolError
from telepresence.haptics.sample import (
    FLAG_ACTED,
    FLAG_CONTACT,
    FLAG_DEAD_MAN,
    FLAG_FEEDBACK,
    FLAG_HALTED,
    FLAG_HOLDING,
    FLAG_SATURATED,
    MODE_POSITION,
    STATE_HALTED,
    Command,
    Feedback,
    pack_command,
    pack_feedback,
    unpack_command,
    unpack_feedback,
)

# Dead-man button 0x10; state 3 with the buttons 0 and 2 (0b0101): 0x53.
# 0.06 m = 3000 counts = 0x0BB8; -0.05 m = -2500 = 0xF63C; 123456789 µJ = 0x075BCD15.
COMMAND = bytes.fromhex("1234 10 53 0bb8 f63c 075bcd15")
# Feedback 0x80 and contact 0x01; impedance 3 with LED 2 lit: (2 + 1) << 4 | 3 = 0x33.
# -7 N = -3500 counts = 0xF254; 0.5 N = 250 = 0x00FA; 1 µJ less than the wrap.
FEEDBACK = bytes.fromhex("ffff 81 33 f254 00fa ffffffff")


def test_command_golden() -> None:
    assert pack_command(0x1234, Command(0.06, -0.05, 123_456_789, buttons=0b0101)) == COMMAND
    sequence, flags, command = unpack_command(COMMAND)
    assert (sequence, flags) == (0x1234, FLAG_DEAD_MAN)
    assert command == pytest.approx((0.06, -0.05, 123_456_789, True, 3, 5, False, False))


def test_feedback_golden() -> None:
    assert pack_feedback(65535, Feedback(-7.0, 0.5, (1 << 32) - 1, True, lit=2)) == FEEDBACK
    sequence, flags, feedback = unpack_feedback(FEEDBACK)
    assert (sequence, flags) == (65535, FLAG_FEEDBACK | FLAG_CONTACT)
    assert feedback == pytest.approx((-7.0, 0.5, (1 << 32) - 1, True, 3, 2, False, False))


def test_the_energy_wraps() -> None:
    assert pack_command(0, Command(0.0, 0.0, (1 << 32) + 5)).hex() == "000010030000000000000005"
    feedback = unpack_feedback(pack_feedback(0, Feedback(0.0, 0.0, 3 << 32, False)))
    assert feedback.value.energy_uj == 0


def test_flags_show_the_senders_state() -> None:
    command = Command(0.0, 0.0, 0, False, STATE_HALTED, 0, True, True)
    data = pack_command(1, command, holding=True)
    assert data == bytes.fromhex("0001 2c 04 0000 0000 00000000")
    assert unpack_command(data).flags == FLAG_HALTED | FLAG_ACTED | FLAG_HOLDING
    assert unpack_command(data).value == command
    feedback = Feedback(0.0, 0.0, 0, False, MODE_POSITION, None, True, True)
    data = pack_feedback(1, feedback)
    assert data == bytes.fromhex("0001 a8 02 0000 0000 00000000")
    assert unpack_feedback(data).value == feedback


def test_values_out_of_range_saturate_and_set_a_flag() -> None:
    data = pack_command(0, Command(9.0, -math.inf, 0), holding=True)
    assert data == bytes.fromhex("0000 16 03 7fff 8001 00000000")
    assert unpack_command(data).flags == FLAG_DEAD_MAN | FLAG_SATURATED | FLAG_HOLDING
    data = pack_feedback(65536, Feedback(-1e6, 0.0, 0, False))
    assert data == bytes.fromhex("0000 82 03 8001 0000 00000000")
    data = pack_feedback(0, Feedback(0.0, 65.534, 0, False))
    assert data == bytes.fromhex("0000 80 03 0000 7fff 00000000")


def test_not_a_number_is_refused() -> None:
    with pytest.raises(ValueError):
        pack_command(0, Command(math.nan, 0.0, 0))
    with pytest.raises(ValueError):
        pack_feedback(0, Feedback(0.0, math.nan, 0, False))


@pytest.mark.parametrize(
    "data",
    [b"", COMMAND[:-1], COMMAND + b"\0", FEEDBACK, bytes.fromhex("0000 10 03 8000 0000 00000000")],
)
def test_an_invalid_command_is_refused(data: bytes) -> None:
    with pytest.raises(ProtocolError):
        unpack_command(data)


@pytest.mark.parametrize("data", [COMMAND, bytes.fromhex("0000 80 03 0000 8000 00000000")])
def test_an_invalid_feedback_is_refused(data: bytes) -> None:
    with pytest.raises(ProtocolError):
        unpack_feedback(data)


def test_the_unused_flag_is_ignored() -> None:
    later = bytes.fromhex("1234 50 53 0bb8 f63c 075bcd15")
    assert unpack_command(later).value == unpack_command(COMMAND).value

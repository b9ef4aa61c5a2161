"""The 12-octet sample, octet by octet: worked out by hand from the table in sample.py."""

import math

import pytest

from kontur_av.errors import ProtocolError
from telepresence.haptics.sample import (
    FLAG_CONTACT,
    FLAG_FEEDBACK,
    FLAG_HOLDING,
    FLAG_SATURATED,
    Command,
    Feedback,
    pack_command,
    pack_feedback,
    unpack_command,
    unpack_feedback,
)

# 0.06 m = 3000 counts = 0x0BB8; -0.05 m = -2500 = 0xF63C; 0.1 m/s = 1000 = 0x03E8;
# -0.25 m/s = -2500 = 0xF63C.
COMMAND = bytes.fromhex("1234 00 00 0bb8 f63c 03e8 f63c")
# -7 N = -3500 counts = 0xF254; 0.5 N = 250 = 0x00FA.
FEEDBACK = bytes.fromhex("ffff 81 00 0bb8 f63c f254 00fa")


def test_command_golden() -> None:
    assert pack_command(0x1234, Command(0.06, -0.05, 0.1, -0.25)) == COMMAND
    sequence, flags, command = unpack_command(COMMAND)
    assert (sequence, flags) == (0x1234, 0)
    assert command == pytest.approx((0.06, -0.05, 0.1, -0.25))


def test_feedback_golden() -> None:
    assert pack_feedback(65535, Feedback(-7.0, 0.5, 0.06, -0.05, True)) == FEEDBACK
    sequence, flags, feedback = unpack_feedback(FEEDBACK)
    assert (sequence, flags) == (65535, FLAG_FEEDBACK | FLAG_CONTACT)
    assert feedback[:4] == pytest.approx((-7.0, 0.5, 0.06, -0.05))
    assert feedback.contact


def test_values_out_of_range_saturate_and_say_so() -> None:
    data = pack_command(0, Command(9.0, -9.0, math.inf, -math.inf), holding=True)
    assert data == bytes.fromhex("0000 06 00 7fff 8001 7fff 8001")
    assert unpack_command(data).flags == FLAG_SATURATED | FLAG_HOLDING
    data = pack_feedback(65536, Feedback(-1e6, 0.0, 0.0, 0.0, False))
    assert data == bytes.fromhex("0000 82 00 0000 0000 8001 0000")


@pytest.mark.parametrize("field", range(4))
def test_each_value_saturates_for_itself(field: int) -> None:
    values = [0.0] * 4
    values[field] = 9.0
    sample = unpack_command(pack_command(0, Command(*values)))
    assert sample.flags == FLAG_SATURATED
    assert sample.value[field] == pytest.approx(0.65534 if field < 2 else 3.2767)


def test_not_a_number_is_refused() -> None:
    with pytest.raises(ValueError):
        pack_command(0, Command(math.nan, 0.0, 0.0, 0.0))


@pytest.mark.parametrize(
    "data",
    [b"", COMMAND[:-1], COMMAND + b"\0", FEEDBACK, bytes.fromhex("0000 00 00 8000 0000 0000 0000")],
)
def test_what_is_no_command_is_refused(data: bytes) -> None:
    with pytest.raises(ProtocolError):
        unpack_command(data)


def test_a_command_is_no_feedback() -> None:
    with pytest.raises(ProtocolError):
        unpack_feedback(COMMAND)


def test_reserved_octet_and_unknown_flags_are_ignored() -> None:
    later = bytes.fromhex("1234 78 5a 0bb8 f63c 03e8 f63c")
    assert unpack_command(later).value == unpack_command(COMMAND).value

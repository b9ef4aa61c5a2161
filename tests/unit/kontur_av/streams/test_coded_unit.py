"""Access units as samples of a topic."""

import pytest

from kontur_av.errors import ProtocolError
from kontur_av.streams.coded_unit import CodedUnit

LARGEST = CodedUnit(data=bytes(1 << 20), key=True, parameter_sets=b"sets")


@pytest.mark.parametrize(
    "unit",
    [
        CodedUnit(data=b"\0\0\0\1\x65abc", key=True, width=384, height=288),
        CodedUnit(data=b"\0\0\0\1\x41a", key=False, width=640, height=480, dated=False),
        CodedUnit(data=b"x", key=False, damaged=True, dated=False),
        CodedUnit(data=b"x", key=False, codec="h265", dated=True),
        CodedUnit(data=b"", key=False, refused=True, dated=False, parameter_sets=b"sets"),
        LARGEST,
    ],
)
def test_a_unit_comes_back_as_it_was(unit):
    assert CodedUnit.unpack(unit.pack()) == unit


def test_octets_of_another_length_are_refused():
    packed = CodedUnit(data=b"\0\0\0\1\x65abc", key=True).pack()
    for octets in (b"", packed[:11], packed[:-1], packed + b"\0"):
        with pytest.raises(ProtocolError, match="a coded unit of"):
            CodedUnit.unpack(octets)


def test_a_unit_is_dated_and_whole_unless_told_and_has_a_mebibyte_at_most():
    unit = CodedUnit(data=b"", key=False)
    assert (unit.dated, unit.damaged, unit.refused) == (True, False, False)
    assert (unit.width, unit.height) == (0, 0)
    with pytest.raises(ProtocolError, match="a coded unit of 1048577"):
        CodedUnit.unpack(CodedUnit(data=bytes((1 << 20) + 1), key=True).pack())

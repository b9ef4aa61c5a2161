"""Access units as samples of a topic."""

import pytest

from kontur_av.errors import ProtocolError
from kontur_av.streams.coded_unit import CodedUnit

UNITS = [
    CodedUnit(data=b"\0\0\0\1\x65abc", key=True, width=384, height=288),
    CodedUnit(data=b"\0\0\0\1\x41a", key=False, damaged=True, width=640, height=480),
    CodedUnit(data=b"", key=False, refused=True, dated=False, parameter_sets=b"sets"),
]


@pytest.mark.parametrize("unit", UNITS, ids=["key", "damaged", "refused"])
def test_a_unit_comes_back_as_it_was(unit):
    assert CodedUnit.unpack(unit.pack()) == unit


def test_octets_of_another_length_are_refused():
    packed = UNITS[0].pack()
    for octets in (b"", packed[:11], packed[:-1], packed + b"\0"):
        with pytest.raises(ProtocolError, match="a coded unit of"):
            CodedUnit.unpack(octets)

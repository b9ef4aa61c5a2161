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


def test_each_flag_and_codec_comes_back_alone():
    for name in ("damaged", "refused", "dated"):
        for codec in ("h264", "h265"):
            flags = dict.fromkeys(("damaged", "refused", "dated"), False) | {name: True}
            unit = CodedUnit(data=b"x", key=False, codec=codec, **flags)
            assert CodedUnit.unpack(unit.pack()) == unit
    assert CodedUnit(data=b"", key=False) == CodedUnit(
        data=b"", key=False, dated=True, damaged=False, refused=False, width=0, height=0
    )


def test_a_unit_of_more_than_a_mebibyte_is_refused():
    largest = CodedUnit(data=bytes(1 << 20), key=True, parameter_sets=b"sets")
    assert CodedUnit.unpack(largest.pack()) == largest
    with pytest.raises(ProtocolError, match="a coded unit of 1048577"):
        CodedUnit.unpack(CodedUnit(data=bytes((1 << 20) + 1), key=True).pack())

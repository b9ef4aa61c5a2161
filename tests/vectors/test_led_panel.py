"""The LED panel's datagrams, octet by octet; their checks come from a calculation bit by bit."""

import pytest

from kontur_av.errors import ProtocolError
from telepresence.tasks.definitions import Pattern
from telepresence.tasks.panel_picture import (
    DARK,
    PanelPicture,
    pack_acknowledgement,
    pack_picture,
    parse_acknowledgement,
    parse_picture,
)

VECTORS = [
    ("4c01 00000001 00 00 000000 0000 0000 cc19", 1, DARK),
    (
        "4c01 01020304 01 81 fff4d6 0000 0000 ac60",
        0x01020304,
        PanelPicture(Pattern.LEDS, 0x81),
    ),
    (
        "4c01 ffffffff 02 00 00ff00 ee6c 03e8 2c48",
        0xFFFFFFFF,
        PanelPicture(Pattern.SPOT, spot_m=(-0.045, 0.01), colour=(0, 255, 0)),
    ),
]


@pytest.mark.parametrize(("octets", "number", "picture"), VECTORS)
def test_a_state_in_octets(octets, number, picture):
    assert pack_picture(number, picture).hex() == octets.replace(" ", "")
    found, parsed = parse_picture(bytes.fromhex(octets))
    assert (found, parsed.pattern, parsed.leds, parsed.colour) == (
        number,
        picture.pattern,
        picture.leds,
        picture.colour,
    )
    assert parsed.spot_m == pytest.approx(picture.spot_m)


def test_an_acknowledgement_in_octets():
    assert pack_acknowledgement(0x01020304).hex(" ") == "41 01 01 02 03 04 86 f2"
    assert parse_acknowledgement(pack_acknowledgement(7)) == 7


def test_each_octet_is_checked():
    for octets, parse in (
        (pack_picture(9, PanelPicture(Pattern.LEDS, 3)), parse_picture),
        (pack_acknowledgement(9), parse_acknowledgement),
    ):
        for place in range(len(octets)):
            for bit in range(8):
                changed = bytearray(octets)
                changed[place] ^= 1 << bit
                with pytest.raises(ProtocolError):
                    parse(bytes(changed))

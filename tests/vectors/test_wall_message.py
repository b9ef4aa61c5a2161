"""The message with a wall octet by octet, computed by hand from CCSDS 133.0-B-2, clause 4.1.3."""

import pytest

from kontur_av.errors import ProtocolError
from telepresence.haptics.mediated.wall import Wall, WallMessage, is_wall, pack_wall, parse_wall
from telepresence.tmtc.pus.head import is_packet

# 000 0 0 00100000011 | 11 00000000000101 | length 10 - 1 = 9 | version 1, to +x, 3035 ms = 0xbdb,
# 60 mm = 3000 counts = 0xbb8, 1500 N/m = 0x5dc
WALL = bytes.fromhex("0103 c005 0009 01 01 00000bdb 0bb8 05dc")
# To -y, at -115 mm = -5750 counts = 0xe98a, 200 N/m = 0xc8
PLATE = bytes.fromhex("0103 ffff 0009 01 04 ffffffff e98a 00c8")
NONE = bytes.fromhex("0103 c000 0009 01 00 00000000 0000 0000")

VECTORS = [
    (WALL, 5, WallMessage(3035, Wall(0, 1, 3000 * 20e-6, 1500.0))),
    (PLATE, 16383, WallMessage((1 << 32) - 1, Wall(1, -1, -5750 * 20e-6, 200.0))),
    (NONE, 0, WallMessage(0, None)),
]


@pytest.mark.parametrize(("octets", "count", "message"), VECTORS)
def test_golden(octets, count, message):
    assert pack_wall(message, count) == octets
    assert pack_wall(message, count + 16384) == octets
    assert parse_wall(octets) == message
    # The link takes it beside PUS; PUS does not.
    assert is_wall(octets)
    assert not is_packet(octets)


def test_values_out_of_range_are_cut():
    far = parse_wall(pack_wall(WallMessage(1, Wall(0, 1, -9.0, 1e9)), 0)).wall
    assert far == Wall(0, 1, -32767 * 20e-6, 20_000.0)
    soft = parse_wall(pack_wall(WallMessage(1, Wall(0, 1, 9.0, 0.1)), 0)).wall
    assert soft == Wall(0, 1, 32767 * 20e-6, 10.0)


@pytest.mark.parametrize(
    "octets",
    [
        b"",
        WALL[:-1],
        WALL + b"\0",
        b"\x11" + WALL[1:],  # a telecommand
        WALL[:1] + b"\x02" + WALL[2:],  # another APID
        WALL[:2] + b"\x40" + WALL[3:],  # a first segment
        WALL[:5] + b"\x08" + WALL[6:],  # another length
        WALL[:6] + b"\x02" + WALL[7:],  # another version
        WALL[:7] + b"\x05" + WALL[8:],  # no direction
        WALL[:7] + b"\x00" + WALL[8:],  # no wall, but a surface
        WALL[:12] + b"\x80\x00" + WALL[14:],  # a surface of -32768
        WALL[:14] + b"\x00\x09",  # 9 N/m
        WALL[:14] + b"\x4e\x21",  # 20001 N/m
    ],
)
def test_what_is_no_wall_is_refused(octets):
    with pytest.raises(ProtocolError):
        parse_wall(octets)

"""The message with a wall octet by octet, computed by hand from CCSDS 133.0-B-2, clause 4.1.3."""

from math import tau

import pytest

from telepresence.haptics.mediated.wall import Wall, WallMessage, is_wall, pack_wall, parse_wall
from telepresence.tmtc.pus.head import is_packet

# 000 0 0 00100000011 | 11 00000000000101 | length 10 - 1 = 9 | version 2, 1/8 turn = 0x2000,
# 3035 ms = 0xbdb, 60 mm = 3000 counts = 0xbb8, 1500 N/m = 0x5dc
WALL = bytes.fromhex("0103 c005 0009 02 2000 000bdb 0bb8 05dc")
# To -y, 3/4 turn = 0xc000, at -115 mm = -5750 counts = 0xe98a, 200 N/m = 0xc8
PLATE = bytes.fromhex("0103 ffff 0009 02 c000 ffffff e98a 00c8")
NONE = bytes.fromhex("0103 c000 0009 02 0000 000000 0000 0000")
VECTORS = [
    (WALL, 5, WallMessage(3035, Wall(tau / 8, 3000 * 20e-6, 1500.0))),
    (PLATE, 16383, WallMessage((1 << 24) - 1, Wall(tau * 3 / 4, -5750 * 20e-6, 200.0))),
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


@pytest.mark.parametrize("angle_rad", [-tau / 8, tau - tau / 200_000, 5 * tau])
def test_an_angle_and_a_stamp_wrap(angle_rad):
    message = parse_wall(pack_wall(WallMessage((1 << 24) + 3, Wall(angle_rad, 0.06, 1500.0)), 0))
    assert message.stamp_ms == 3
    away = (message.wall.angle_rad - angle_rad + tau / 2) % tau - tau / 2
    assert 0.0 <= message.wall.angle_rad < tau
    assert abs(away) <= tau / 65536

"""The message with a wall is read back as written; a plane pushes from its surface on."""

import struct
from math import pi, tau

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kontur_av.errors import ProtocolError
from telepresence.haptics.mediated.wall import Wall, WallMessage, is_wall, pack_wall, parse_wall

counts = st.integers(-32767, 32767)


@given(
    st.integers(0, 1 << 25),
    st.integers(0, 1 << 15),
    st.integers(0, 65535),
    counts,
    st.integers(10, 20_000),
)
def test_a_wall_is_read_as_it_was_written(stamp_ms, count, turn, distance, stiffness):
    wall = Wall(turn * tau / 65536, distance * 20e-6, float(stiffness))
    data = pack_wall(WallMessage(stamp_ms, wall), count)
    assert is_wall(data) and len(data) == 16
    # CCSDS 133.0-B-2: version 0, telemetry, this APID; unsegmented; its length less one.
    assert struct.unpack_from(">HHH", data) == (0x103, 0xC000 | count % 16384, 9)
    read = parse_wall(data)
    assert read.stamp_ms == stamp_ms % (1 << 24)
    assert (read.wall.angle_rad, read.wall.distance_m, read.wall.stiffness_n_m) == pytest.approx(
        (wall.angle_rad, wall.distance_m, wall.stiffness_n_m)
    )
    none = pack_wall(WallMessage(stamp_ms, None), count)
    assert parse_wall(none) == WallMessage(stamp_ms % (1 << 24), None)
    assert none[6:9] == b"\x02\0\0" and none[12:] == bytes(4)


def test_a_wall_has_these_octets():
    # 1/8 turn = 0x2000, 3035 ms = 0xbdb, 60 mm = 3000 counts = 0xbb8, 1500 N/m = 0x5dc
    wall = Wall(tau / 8, 3000 * 20e-6, 1500.0)
    octets = bytes.fromhex("0103 c005 0009 02 2000 000bdb 0bb8 05dc")
    assert pack_wall(WallMessage(3035, wall), 5) == octets


def test_a_wall_out_of_range_is_cut_and_one_that_is_never_sent_refused():
    for wall, cut in (
        (Wall(tau - 1e-6, 9.0, 1e6), (0.0, 0.65534, 20_000.0)),
        (Wall(-pi / 2, -9.0, 0.1), (1.5 * pi, -0.65534, 10.0)),
    ):
        read = parse_wall(pack_wall(WallMessage(0, wall), 0)).wall
        assert (read.angle_rad, read.distance_m, read.stiffness_n_m) == pytest.approx(cut)
    good = list(pack_wall(WallMessage(5, Wall(1.0, 0.05, 1500.0)), 3))
    none = list(pack_wall(WallMessage(5, None), 3))
    for octets, change, words in (
        (good, {1: 4}, "header of its space packet"),
        (good, {2: 0x40}, "header of its space packet"),
        (good, {5: 10}, "header of its space packet"),
        (good, {6: 1}, "version 1 instead of 2"),
        (good, {12: 0x80, 13: 0}, "never sent"),
        (good, {14: 0, 15: 9}, "stiffness of 9 N/m"),
        (good, {14: 0x4E, 15: 0x21}, "stiffness of 20001 N/m"),
        (none, {8: 1}, "of no wall"),
        (none, {13: 1}, "of no wall"),
    ):
        data = bytes({**dict(enumerate(octets)), **change}.values())
        assert is_wall(data) is ("header" not in words)
        with pytest.raises(ProtocolError, match=words):
            parse_wall(data)
    for data in (bytes(good[:-1]), bytes([*good, 0])):
        assert not is_wall(data)
        with pytest.raises(ProtocolError, match="octets instead of 16"):
            parse_wall(data)


def test_a_plane_pushes_from_its_surface_on():
    wall = Wall(pi / 6, 0.05, 1000.0)
    x, y = wall.inward
    assert (x, y) == pytest.approx((3**0.5 / 2, 0.5))
    assert wall.depth_m(0.052 * x, 0.052 * y) == pytest.approx(0.002)
    assert wall.force_n(0.052 * x - y, 0.052 * y + x) == pytest.approx((-2.0 * x, -2.0 * y))
    assert wall.force_n(0.049 * x, 0.049 * y) == pytest.approx((0.0, 0.0))
    moved = wall.moved(0.01, -0.03)
    assert moved.distance_m == pytest.approx(0.05 + 0.01 * x - 0.03 * y)
    assert (moved.angle_rad, moved.stiffness_n_m) == (wall.angle_rad, wall.stiffness_n_m)

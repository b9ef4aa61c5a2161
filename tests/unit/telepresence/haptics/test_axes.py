"""Axes behind x and y: in samples, and in what a setup costs."""

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kontur_av.errors import ConfigError, ProtocolError
from pipelines.session.setup.setup_file import TASKBOARD
from telepresence.haptics.axes import (
    AXIS_OCTETS,
    MOST_AXIS_ENERGY_UJ,
    AxisCapabilities,
    AxisSettings,
    check_axes,
    pack_axes,
    read_axes,
)
from telepresence.haptics.sample import POSITION_M, SAMPLE_OCTETS
from telepresence.link.profile import UPLINK

Z = AxisCapabilities(name="z", half_range=0.1, force_limit=10.0, speed=0.5)
values = st.tuples(st.floats(-0.6, 0.6), st.integers(0, MOST_AXIS_ENERGY_UJ), st.booleans())


@given(st.lists(values, min_size=1, max_size=5))
def test_what_is_packed_is_read_back(sent):
    data = pack_axes(sent, [0] * len(sent), POSITION_M)
    assert len(data) == AXIS_OCTETS * len(sent)
    for (value, *rest), (heard, *read) in zip(sent, read_axes(data, POSITION_M), strict=True):
        assert abs(value - heard) <= 0.5 * POSITION_M + 1e-12
        assert read == rest


def test_more_axes_have_these_octets():
    # z: 0.05 m = 2500 counts = 0x09c4; 200000 µJ of this session = 0x030d40.
    # yaw: -0.5 rad at a lever of 0.1 m = -2500 = 0xf63c; its controller acted: 0x800000.
    values = [(0.05, 1_200_000, False), (-0.05, 0, True)]
    data = bytes.fromhex("09c4 030d40 f63c 800000")
    assert pack_axes(values, (1_000_000, 0), POSITION_M) == data


def test_a_count_that_is_never_sent_is_refused():
    with pytest.raises(ProtocolError, match="-32768"):
        read_axes(b"\x80\x00\x00\x00\x00", POSITION_M)


def test_a_robot_with_other_axes_is_refused():
    with pytest.raises(ConfigError, match="robot arm has the axes x, y, z, but the setup"):
        check_axes("robot arm", (Z,), ("yaw",))


def test_a_setup_says_what_more_axes_cost():
    with pytest.raises(
        ConfigError, match=r"17 octets of each frame, 136 kbit/s in place of 96.*39"
    ):
        replace(TASKBOARD, axes=("x", "y", "z"))
    names = ("x", "y", "roll", "z", "yaw", "pitch", "gripper")
    setup = replace(TASKBOARD, axes=names, uplink=WIDE)
    assert setup.more_axes == names[2:]
    octets = SAMPLE_OCTETS + 5 * AXIS_OCTETS
    assert (setup.uplink.insert_octets, setup.downlink.insert_octets) == (octets, octets)
    assert TASKBOARD.uplink.insert_octets == SAMPLE_OCTETS


WIDE = replace(UPLINK, frame_octets=60, pointer_in_vcid=False)
PAN = AxisSettings(kind="rotary", mode="rate", scale=2.0)


@pytest.mark.parametrize(
    ("axes", "settings", "words"),
    [
        (("x", "pan"), {}, r'\[axis.pan\] kind = "rotary"'),
        (("x", "Pan"), {}, "lower-case"),
        (("x", "x"), {}, "named twice"),
        ((), {}, "is empty"),
        (("pan",), {"tilt": PAN}, "axes does not name it"),
        (("x",), {"x": PAN}, "safety has the limits"),
        (("z",), {"z": PAN}, "axis z is linear"),
        (("pan",), {"pan": replace(PAN, speed=0.0)}, "take more than 0"),
        (("aa", "bb", "cc", "dd"), dict.fromkeys(("aa", "bb", "cc", "dd"), PAN), "at most 3"),
    ],
)
def test_axes_that_cannot_be_are_refused_with_the_fix(axes, settings, words):
    with pytest.raises(ConfigError, match=words):
        replace(TASKBOARD, axes=axes, axis=settings, uplink=WIDE)

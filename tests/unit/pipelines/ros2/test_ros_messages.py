"""Messages of ROS 2, octet by octet."""

import struct
from contextlib import suppress

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from kontur_av.errors import ProtocolError
from pipelines.hand.haptic_trace import DEAD_MAN, row_type
from pipelines.ros2.publications import IMAGE, JOY, POSE, TEXT
from pipelines.ros2.ros_messages import RosMessages

MESSAGES = RosMessages(1_000)
#: CDR of little-endian (OMG DDSI-RTPS 10.2).
HEAD = b"\0\x01\0\0"


def test_texts_pictures_hashes_and_diagnostics_are_those_of_ros_2():
    assert MESSAGES.text("hi") == HEAD + b"\x03\0\0\0hi\0"
    stamp = struct.pack("<iI", 5, 1_007)
    name, kind = b"\x05\0\0\0head\0" + b"\0" * 3, b"\x05\0\0\0jpeg\0" + b"\0" * 3
    picture = MESSAGES.image(np.arange(3, dtype=np.uint8), "head", 5_000_000_007)
    assert picture == HEAD + stamp + name + kind + b"\x03\0\0\0\0\1\2"
    unit = MESSAGES.video(b"\0\0\1\x65", "up", 5_000_000_007)
    data = b"\x04\0\0\0\0\0\1\x65\x05\0\0\0h264\0"
    assert unit == HEAD + stamp + b"\x03\0\0\0up\0\0" + data
    # From the messages' own files in ROS 2 Jazzy.
    known = {TEXT: "df668c7", IMAGE: "1564077", JOY: "0d356c7", POSE: "10f3786"}
    for kind, begin in known.items():
        assert MESSAGES.type_hash(kind)[:14] == f"RIHS01_{begin}"
    octets = MESSAGES.diagnostics(["uplink is lost"], {"link up": {"frames": 7}}, 0)
    for text in (b"uplink is lost\0", b"kontur_av: link up\0", b"frames\0", b"\x02\0\0\0007\0"):
        assert text in octets


def rows():
    found = np.zeros(2, row_type(("z_m", "roll_rad", "pitch_rad", "yaw_rad", "gripper_m")))
    found["time_ns"] = 0, 20_000_000
    found["x_m"], found["y_m"], found["z_m"] = (0.0, 0.01), 0.02, 0.03
    found["yaw_rad"], found["fx_n"], found["yaw_n_m"] = np.pi / 2, 4.0, 0.5
    found["flags"] = DEAD_MAN
    return found


def values(octets, count, width=8):
    """The numbers at the end of a message."""
    return struct.unpack(f"<{count}{'d' if width == 8 else 'f'}", octets[-count * width :])


def test_the_hand_in_the_units_of_ros_2():
    x, y, z, *turned = values(MESSAGES.pose(rows(), "tip"), 7)
    assert (x, y, z) == pytest.approx((0.01, 0.02, 0.03))
    assert turned == pytest.approx((0.0, 0.0, 0.5**0.5, 0.5**0.5))
    assert values(MESSAGES.twist(rows(), "tip"), 6) == pytest.approx((0.5, 0, 0, 0, 0, 0))
    assert values(MESSAGES.wrench(rows(), "tip"), 6) == pytest.approx((4.0, 0, 0, 0, 0, 0.5))
    joy = MESSAGES.read_joy(MESSAGES.joy(rows(), "handle", {"x": 0.1, "y": 0.08, "z": 0.1}))
    # To the right is less than 0, as ROS 2 has it.
    assert joy.axes == pytest.approx((-0.1, 0.25, 0.3)) and joy.buttons == (False,) * 4 + (True,)
    assert MESSAGES.read_velocity(MESSAGES.twist(rows(), "tip"))["x"] == pytest.approx(0.5)


JOY_OCTETS = MESSAGES.joy(rows(), "handle", {"x": 0.1, "y": 0.08})


@given(
    st.binary(max_size=200)
    | st.tuples(st.integers(0, len(JOY_OCTETS) - 1), st.binary(max_size=9)).map(
        lambda cut: JOY_OCTETS[: cut[0]] + cut[1] + JOY_OCTETS[cut[0] + len(cut[1]) :]
    )
)
def test_garbage_of_strangers_is_refused_or_read(octets):
    for read in (MESSAGES.read_joy, MESSAGES.read_velocity):
        with suppress(ProtocolError):
            read(octets)
    with pytest.raises(ProtocolError, match="too long"):
        MESSAGES.read_joy(JOY_OCTETS + bytes(5000))

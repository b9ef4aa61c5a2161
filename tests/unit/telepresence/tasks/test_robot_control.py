"""Power, mode, moves and faults of the robot."""

from math import inf, nan

import pytest

from telepresence.haptics.board import Board, WallModel
from telepresence.haptics.robot import Robot
from telepresence.haptics.sample import MODE_OFF
from telepresence.tasks.definitions import ControlMode
from telepresence.tasks.robot_control import TORQUE_NS, Fault, RobotControl, RobotLimits

MS = 1_000_000


class Control(RobotControl):
    """With its own time."""

    now_ns = 0

    def run(self, milliseconds):
        for _ in range(milliseconds):
            self.now_ns += MS
            self.step(self.now_ns)
            if not self.robot.coupled:
                self.robot.drive(MS)

    def move(self, x_m, y_m):
        return self.move_to(x_m, y_m, self.now_ns)

    def torque(self, first, second):
        return self.set_torque(first, second, self.now_ns)


def on_at(x_m=0.0, y_m=0.0, mode=ControlMode.POSITION, **limits):
    control = Control(Robot(x_m=x_m, y_m=y_m), limits=RobotLimits(**limits))
    control.set_mode(mode)
    assert control.set_power(True) == ""
    return control


def test_it_is_off_at_first_and_moves_only_on_and_in_position_control():
    control = Control(Robot())
    assert control.robot.mode == MODE_OFF
    assert "not on in position or impedance control" in control.move(0.02, 0.0)
    control.set_power(True)
    assert "switch it off first" in control.set_mode(ControlMode.TORQUE)
    assert "not on in torque control" in control.torque(1.0, 0.0)
    assert control.move(0.02, 0.01) == ""
    control.run(3000)
    assert control.reached_m == (0.02, 0.01)
    assert control.refused == 3


def test_no_goal_outside_of_the_workspace_is_taken():
    control = on_at()
    for goal_m in ((0.2, 0.0), (0.0, -0.13), (nan, 0.0)):
        assert "outside of the workspace" in control.move(*goal_m)


@pytest.mark.rule("10")
@pytest.mark.parametrize(
    ("attribute", "value", "kind"),
    [
        ("push_x_n", 30.0, Fault.FORCE),
        ("vy_m_s", -2.0, Fault.SPEED),
        ("x_m", 0.18, Fault.WORKSPACE),
        ("y_m", nan, Fault.WORKSPACE),
    ],
)
def test_a_broken_limit_switches_it_off_until_it_is_reset_and_switched_on(attribute, value, kind):
    control = on_at(mode=ControlMode.TELEPRESENCE)
    good = getattr(control.robot, attribute)
    setattr(control.robot, attribute, value)
    control.step(control.now_ns)
    assert (control.powered, control.kind, control.faults) == (False, kind, 1)
    assert control.robot.mode == MODE_OFF
    assert control.fault in control.set_power(True)
    setattr(control.robot, attribute, good)
    control.step(control.now_ns)
    assert not control.telepresent
    assert control.reset() == ""
    assert not control.powered
    assert control.set_power(True) == ""
    assert control.telepresent


def test_a_fault_whose_cause_is_there_is_not_reset():
    control = on_at()
    control.robot.push_y_n = -29.0
    control.step(control.now_ns)
    assert control.reset() == "the cause is still there: force above 28 N"
    assert control.fault


def test_a_trainers_fault_switches_it_off_and_is_reset_once_it_is_over():
    control = on_at()
    control.handle_exercise(control.now_ns + 1000 * MS)
    control.step(control.now_ns)
    assert (control.powered, control.faults) == (False, 1)
    assert "a drive reports" in control.reset()
    control.step(control.now_ns + 1000 * MS)
    assert control.reset() == control.set_power(True) == ""
    assert control.faults == 1


def test_a_robot_outside_of_its_workspace_is_moved_back_in_position_control():
    control = on_at(-0.1, mode=ControlMode.TELEPRESENCE, width_m=0.09)
    control.step(control.now_ns)
    assert control.kind is Fault.WORKSPACE
    assert control.reset() == ""
    assert "move it back in position" in control.set_power(True)
    control.set_mode(ControlMode.POSITION)
    assert control.set_power(True) == ""
    assert control.move(-0.05, 0.0) == ""
    control.run(3000)
    assert (control.reached_m, control.faults) == ((-0.05, 0.0), 1)
    # It has been inside, so that leaving is a fault again.
    control.robot.x_m = -0.1
    control.step(control.now_ns)
    assert control.faults == 2


def pressed_n(mode, stiffness_n_m):
    """Move 20 mm into a wall of 1500 N/m; return the force there."""
    control = Control(Robot(board=Board(WallModel(stiffness_n_m=1500.0)), x_m=0.05))
    assert control.set_mode(mode) == control.set_impedance(stiffness_n_m, 30.0) == ""
    assert control.set_power(True) == control.move(0.08, 0.0) == ""
    control.run(3000)
    return control.robot.force_n


def test_in_impedance_control_the_tip_yields_as_its_spring_does():
    # Two springs in series.
    for stiffness_n_m in (100.0, 400.0):
        due_n = 0.02 * stiffness_n_m * 1500.0 / (stiffness_n_m + 1500.0)
        assert pressed_n(ControlMode.IMPEDANCE, stiffness_n_m) == pytest.approx(due_n, rel=0.01)
    assert pressed_n(ControlMode.POSITION, 100.0) > 15.0


def test_impedance_control_begins_where_the_tip_is_and_moves_to_a_goal():
    control = on_at(0.03, -0.02, ControlMode.IMPEDANCE)
    control.run(500)
    assert (control.robot.x_m, control.robot.y_m) == (0.03, -0.02)
    assert control.move(-0.01, 0.02) == ""
    control.run(100)
    assert control.reached_m is None
    control.run(3000)
    assert control.reached_m == (-0.01, 0.02)
    # A stiffer spring pulls to the same place.
    assert control.set_impedance(2000.0, 60.0) == ""
    control.run(500)
    assert control.reached_m == (-0.01, 0.02)


def test_a_torque_ends_by_itself_unless_it_is_repeated():
    control = on_at(mode=ControlMode.TORQUE)
    control.run(200)
    assert control.robot.x_m == 0.0
    for _ in range(2):
        assert control.torque(0.02, 0.0) == ""
        control.run(TORQUE_NS // MS - 1)
    fastest_m_s = control.robot.vx_m_s
    # 0.05 N on 0.5 kg for a second, less friction and groove; half as long gives 0.039 m/s.
    assert 0.05 < fastest_m_s < 0.064
    control.run(200)
    assert control.robot.vx_m_s < 0.9 * fastest_m_s


@pytest.mark.parametrize("value", [nan, inf, -5000.0, 5000.0])
def test_no_torque_and_no_spring_beyond_its_limit_is_taken(value):
    control = on_at(mode=ControlMode.TORQUE)
    assert "at most 5 N m" in control.torque(0.0, value)
    assert "0 to 4000 N/m" in control.set_impedance(value, 10.0)
    assert "0 to 200 N s/m" in control.set_impedance(100.0, value)
    control.run(10)
    assert (control.robot.x_m, control.robot.y_m, control.refused) == (0.0, 0.0, 3)

"""A user's robot: it is driven as the simulated one is, within its limits, and switched off."""

import sys
from pathlib import Path

import pytest

from kontur_av.clock import NS_PER_MS as MS
from kontur_av.errors import ConfigError
from telepresence.haptics.bilateral import RobotSide
from telepresence.haptics.envelope import SafetyEnvelope
from telepresence.haptics.robot import JointReading, Robot, RobotFacts
from telepresence.haptics.robot_device import DrivenRobot, RobotReading
from telepresence.haptics.sample import Command
from telepresence.haptics.specs import facts_of, open_device, open_robot
from telepresence.tasks.definitions import ControlMode
from telepresence.tasks.robot_control import RobotControl

SAMPLES = Path(__file__).resolve().parents[4] / "samples"


class Arm:
    """A mass of 1 kg that says what was asked of it."""

    facts = RobotFacts(name="arm", force_limit_n=5.0)

    def __init__(self, takes="force"):
        self.facts = RobotFacts(name="arm", force_limit_n=5.0, takes=takes)
        self.calls = []
        self.force, self.most_n = (0.0, 0.0), 0.0
        self.reading = RobotReading(0.01, 0.02, 0.0, 0.0)
        self.follows = True

    def __getattr__(self, name):
        if name in ("configure", "power_on", "activate", "deactivate", "power_off"):
            return lambda: self.calls.append(name)
        raise AttributeError(name)

    def read(self):
        return self.reading

    def write_force(self, x_n, y_n):
        self.force, self.most_n = (x_n, y_n), max(self.most_n, abs(x_n), abs(y_n))

    def write_position(self, x_m, y_m, vx_m_s, vy_m_s):
        if self.follows:
            self.reading = self.reading._replace(x_m=x_m, y_m=y_m, vx_m_s=vx_m_s, vy_m_s=vy_m_s)

    def advance(self, dt_ns):
        if self.facts.takes == "force":
            x, y, vx, vy, *rest = self.reading
            dt = dt_ns / 1e9
            vx, vy = vx + self.force[0] * dt, vy + self.force[1] * dt
            self.reading = RobotReading(x + vx * dt, y + vy * dt, vx, vy, *rest)


@pytest.fixture(params=["force", "position"])
def arm(request):
    return Arm(request.param)


def follow(side, hand_x_m, seconds, *, begin_ms=0):
    """Press the dead-man button, and move the hand by `hand_x_m`."""
    for cycle in range(round(seconds * 1000)):
        share = min(1.0, max(0.0, (cycle - 50) / 300))
        command = Command(hand_x_m * share, 0.0, 100_000 * (begin_ms + cycle), dead_man=cycle > 20)
        side.link.latest = lambda now_ns, command=command: command
        side.handle_cycle((begin_ms + cycle) * MS, MS)


def test_it_follows_the_hand_from_where_it_stands_and_within_its_force(arm):
    robot = DrivenRobot(arm)
    side = RobotSide(robot=robot, envelope=SafetyEnvelope())
    assert (robot.x_m, robot.y_m) == (0.01, 0.02)
    follow(side, -0.05, 1.0)
    assert arm.reading.x_m == pytest.approx(-0.04, abs=0.005)
    assert arm.reading.y_m == pytest.approx(0.02, abs=0.002)
    assert arm.most_n <= 5.0


def test_it_says_what_its_joints_measure_or_nothing(arm):
    robot = DrivenRobot(arm)
    assert robot.joints == ()
    arm.reading = arm.reading._replace(joints=(JointReading(0.5, 2.0),))
    robot.step(0.0, 0.0, MS)
    assert robot.joints == (JointReading(0.5, 2.0),)


def test_the_simulated_robot_has_an_angle_and_a_torque_of_each_joint():
    robot = Robot(x_m=0.02, y_m=-0.04)
    robot.set_torque(1.5, -0.5)
    robot.drive(MS)
    first, second = robot.joints
    assert first == pytest.approx((0.02 / robot.model.lever_m, 1.5), rel=1e-2)
    assert second == pytest.approx((-0.04 / robot.model.lever_m, -0.5), rel=1e-2)


def test_its_lifecycle_follows_power_and_mode(arm):
    robot = DrivenRobot(arm)
    control = RobotControl(robot, powered=False)
    assert arm.calls == ["configure", "power_on", "activate", "deactivate"]
    control.set_power(True)
    assert arm.calls[4:] == ["activate"]
    control.move_to(0.05, 0.0, 0)
    for cycle in range(3000):
        control.step(cycle * MS)
        robot.drive(MS)
    assert control.is_at(0.05, 0.0) or arm.reading.x_m == pytest.approx(0.05, abs=0.01)
    control.set_power(False)
    robot.close()
    assert arm.calls[5:] == ["deactivate", "power_off"]


@pytest.mark.parametrize(
    "wrong",
    [
        {"error": "the drive is too hot"},
        {"x_m": float("nan")},
        {"push_y_n": float("inf")},
        {"joints": (JointReading(0.5, float("nan")),)},
    ],
)
def test_an_error_and_a_measurement_that_is_no_number_switch_it_off(arm, wrong):
    robot = DrivenRobot(arm)
    control = RobotControl(robot, powered=True, mode=ControlMode.TELEPRESENCE)
    well = arm.reading
    arm.advance = lambda dt_ns: None
    arm.follows = False
    arm.reading = well._replace(**wrong)
    robot.step(0.0, 0.0, MS)
    control.step(MS)
    assert not control.powered and control.fault
    assert "still there" in control.reset()
    arm.reading = well
    robot.drive(MS)
    assert control.reset() == "" and control.set_power(True) == ""


def test_a_robot_that_takes_places_and_does_not_follow_is_switched_off():
    arm = Arm("position")
    robot = DrivenRobot(arm)
    control = RobotControl(robot, powered=True, mode=ControlMode.TELEPRESENCE)
    arm.follows = False
    for cycle in range(500):
        control.step(cycle * MS)
        if not control.powered:
            break
        robot.step(3.0, 0.0, MS)
    assert "does not follow" in control.fault


def test_it_is_named_by_module_and_class(monkeypatch):
    monkeypatch.chdir(SAMPLES)
    monkeypatch.setattr(sys, "path", [*sys.path])
    robot = open_robot("own_robot:Mass")
    assert robot.facts.name == "a mass before a wall"
    assert facts_of("own_robot:Mass").force_limit_n == 25.0


@pytest.mark.parametrize(
    ("spec", "words"),
    [
        ("nothing_here:Arm", "no module 'nothing_here'"),
        ("math:Arm", "has no class 'Arm'"),
        ("math:sqrt", "cannot be made: TypeError"),
        ("arm", "module:Class"),
    ],
)
def test_a_robot_or_joystick_that_is_not_there_is_one_line(spec, words):
    for opened in (facts_of, open_device):
        with pytest.raises(ConfigError, match=words) as refused:
            opened(spec)
        assert "\n" not in str(refused.value)

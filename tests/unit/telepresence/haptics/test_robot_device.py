"""A user's robot: it is driven as the simulated one is, within its limits, and switched off."""

import numpy as np
import pytest

from kontur_av.clock import NS_PER_MS as MS
from kontur_av.errors import ConfigError
from kontur_av.media import Tip
from telepresence.haptics.axes import AxisCapabilities, AxisReading
from telepresence.haptics.bilateral import RobotSide
from telepresence.haptics.envelope import SafetyEnvelope
from telepresence.haptics.loop import robot_link
from telepresence.haptics.robot import JointReading, RobotCapabilities
from telepresence.haptics.robot_device import DrivenRobot, RobotReading
from telepresence.haptics.sample import Command
from telepresence.tasks.definitions import ControlMode
from telepresence.tasks.robot_control import RobotControl

Z = AxisCapabilities(name="z", half_range=0.1, force_limit=10.0, speed=0.5)
YAW = AxisCapabilities(name="yaw", half_range=1.0, force_limit=0.5, speed=3.0)


class Arm:
    """A mass of 1 kg that says what was asked of it."""

    capabilities = RobotCapabilities(name="arm", force_limit_n=5.0)

    def __init__(self, takes="force"):
        self.capabilities = RobotCapabilities(name="arm", force_limit_n=5.0, takes=takes)
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
        if self.capabilities.takes == "force":
            x, y, vx, vy, *rest = self.reading
            dt = dt_ns / 1e9
            vx, vy = vx + self.force[0] * dt, vy + self.force[1] * dt
            self.reading = RobotReading(x + vx * dt, y + vy * dt, vx, vy, *rest)


class Guide(Arm):
    """With z and yaw, which move without mass where they are pushed."""

    def __init__(self, takes="force"):
        super().__init__(takes)
        self.capabilities = RobotCapabilities(name="guide", takes=takes, more=(Z, YAW))
        self.more = [AxisReading(0.0, 0.0)] * 2

    def write_more_forces(self, forces):
        self.more_forces = forces

    def write_more_positions(self, positions, speeds):
        self.more = [AxisReading(position, 0.0) for position in positions]

    def advance(self, dt_ns):
        super().advance(dt_ns)
        if self.capabilities.takes == "force":
            self.more = [
                AxisReading(axis.position + force * gain * dt_ns / 1e9, 0.0)
                for axis, force, gain in zip(self.more, self.more_forces, (0.01, 20.0), strict=True)
            ]

    def read_more(self):
        return self.more


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
    assert (robot.x_m, robot.y_m, robot.joints) == (0.01, 0.02, ())
    follow(side, -0.05, 1.0)
    assert arm.reading.x_m == pytest.approx(-0.04, abs=0.005)
    assert arm.reading.y_m == pytest.approx(0.02, abs=0.002)
    assert arm.most_n <= 5.0
    arm.reading = arm.reading._replace(joints=(JointReading(0.5, 2.0),))
    robot.step(0.0, 0.0, MS)
    assert robot.joints == (JointReading(0.5, 2.0),)


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


class Failing:
    """An arm one of whose calls raises, or returns nonsense."""

    def __init__(self, arm, call, *, returns=None):
        self.arm, self.call, self.returns = arm, call, returns
        self.calls = arm.calls

    def __getattr__(self, name):
        if name != self.call:
            return getattr(self.arm, name)
        if self.returns is not None:
            return lambda *_: self.returns

        def fail(*_):
            raise OSError("E217: gripper jammed")

        return fail


@pytest.mark.parametrize("call", ["advance", "read", "write_force", "deactivate", "activate"])
def test_what_a_driver_raises_is_the_robots_error_and_never_ends_the_session(call):
    arm = Failing(Arm(), "")
    robot = DrivenRobot(arm)
    control = RobotControl(robot, powered=True, mode=ControlMode.TELEPRESENCE)
    if call.endswith("activate"):
        control.set_power(call == "deactivate")
        control.step(MS)
    arm.call = call
    control.set_power(call != "deactivate")
    robot.step(0.0, 0.0, MS) if call == "write_force" else robot.drive(MS)
    said = f"{call}() failed: OSError: E217: gripper jammed"
    if call != "deactivate":
        # The next cycle without trouble clears the error; the fault is kept.
        assert robot.error == said or call == "activate"
    robot.close()
    assert arm.calls[-1] == "power_off"


@pytest.mark.parametrize(
    ("call", "returns"),
    [("read", None), ("read", "nonsense"), ("power_on", None), ("capabilities", {})],
)
def test_a_driver_that_does_not_come_up_is_refused_and_left_without_power(call, returns):
    arm = Arm()
    if call == "capabilities":
        arm.capabilities = returns
        failing = arm
    else:
        failing = Failing(arm, call, returns=returns)
    with pytest.raises(ConfigError, match=r"^(read|power_on)\(\) |^capabilities "):
        DrivenRobot(failing)
    assert "activate" not in arm.calls
    assert arm.calls[-1] == ("configure" if call == "capabilities" else "power_off")


def test_power_that_cannot_be_taken_is_said():
    arm = Failing(Arm(), "")
    robot = DrivenRobot(arm)
    arm.call = "power_off"
    with pytest.raises(ConfigError, match=r"power_off\(\) failed.*: it may still have power"):
        robot.close()


def test_numbers_of_numpy_drive_it(arm):
    arm.tips = {"x": np.array([0.4, 0.5])}.copy
    assert DrivenRobot(arm).tips() == {"x": Tip(0.4, 0.5)}
    numbers = np.array([0.01, 0.02, 0.0, 0.0])
    arm.reading = RobotReading(*numbers, contact=np.bool_(False))
    robot = DrivenRobot(arm)
    robot.step(0.0, 0.0, MS)
    assert {type(one) for one in (robot.x_m, robot.vx_m_s, robot.push_x_n)} == {float}


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


@pytest.mark.parametrize("takes", ["force", "position"])
def test_a_users_axes_are_driven(takes):
    device = Guide(takes)
    side = RobotSide(robot=DrivenRobot(device), link=robot_link(more=2))
    most = [0.0, 0.0]
    for cycle in range(2_000):
        share = min(1.0, cycle / 1000)
        command = Command(
            0.0,
            0.0,
            0,
            more=((0.03 * share, 100 * cycle, False), (0.05 * share, 100 * cycle, False)),
        )
        side.link.latest = lambda now_ns, command=command: command
        side.handle_cycle(cycle * MS, MS)
        most = [max(old, abs(new.position)) for old, new in zip(most, device.more, strict=True)]
    assert side.robot.error == ""
    # m and rad, as the facts have them: yaw's lever has 0.1 m.
    assert most == pytest.approx([0.03, 0.5], rel=0.05)


@pytest.mark.parametrize(
    ("reading", "words"),
    [
        (AxisReading(float("nan"), 0.0), "z is not a number"),
        (AxisReading(0.2, 0.0), "outside of its range"),
        (AxisReading(0.0, 5.0), "beyond twice its speed"),
    ],
)
def test_an_axis_that_measures_what_cannot_be_is_an_error(reading, words):
    device = Guide("position")
    robot = DrivenRobot(device)
    device.more = [reading, AxisReading(0.0, 0.0)]
    device.write_more_positions = lambda positions, speeds: None
    robot.step(0.0, 0.0, MS)
    assert words in robot.error

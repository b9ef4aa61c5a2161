"""A robot and a joystick by UDP, as the session drives them."""

import struct
from itertools import pairwise
from math import isnan

import pytest
from udp_controller import MemoryLine, PythonController

from kontur_av.errors import ConfigError
from telepresence.haptics import udp_devices
from telepresence.haptics.device.operation import JoystickOperation
from telepresence.haptics.device.states import JoystickState
from telepresence.haptics.robot_device import DrivenRobot
from telepresence.haptics.specs import open_robot
from telepresence.haptics.udp_protocol import MOST_UNANSWERED
from telepresence.tasks.definitions import ControlMode
from telepresence.tasks.robot_control import RobotControl

MS = 1_000_000
OFF, POWER, ACTIVE = range(3)


@pytest.fixture
def controller(monkeypatch):
    controller = PythonController()
    monkeypatch.setattr(udp_devices, "UdpLine", lambda _, role: MemoryLine(role, controller))
    return controller


def driven():
    """A robot by UDP, switched on, and its control."""
    robot = DrivenRobot(udp_devices.UdpRobot("127.0.0.1:9"))
    return robot, RobotControl(robot, powered=True, mode=ControlMode.TELEPRESENCE)


def test_a_robot_that_measures_no_force_is_for_a_session_without(controller):
    controller.capabilities = controller.capabilities[:20] + bytes([1, 0])
    controller.capabilities += struct.pack(">2f", 0.15, 0.1) + b"no sensor"
    with pytest.raises(ConfigError, match=r"robot udp:.*measures no force.*add --force none"):
        open_robot("udp:127.0.0.1:9", felt=True)
    assert controller.state == OFF
    assert open_robot("udp:127.0.0.1:9").capabilities.force == "none"


def drive(control, robot, count):
    for cycle in range(count):
        control.step(cycle * MS)
        if robot.mode == 0:
            robot.drive(MS)
        else:
            robot.step(2.0, 0.0, MS)


def test_a_robot_is_moved_and_switched_off_for_good(controller):
    robot, control = driven()
    assert robot.capabilities.force_limit_n == 25.0
    drive(control, robot, 200)
    assert controller.state == ACTIVE and robot.x_m > 0.01
    robot.close()
    assert controller.state == OFF


def test_a_controller_that_dies_switches_the_robot_off_until_it_is_reset(controller):
    robot, control = driven()
    drive(control, robot, 100)
    controller.answers = False
    drive(control, robot, MOST_UNANSWERED + 5)
    assert not control.powered and "did not answer for 100 ms" in control.fault
    assert "still there" in control.reset()
    controller.restart()
    controller.answers = True
    drive(control, robot, 200)
    assert controller.state == POWER and robot.error == "" and controller.speed == [0.0, 0.0]
    assert control.reset() == "" and control.set_power(True) == ""
    drive(control, robot, 50)
    assert controller.state == ACTIVE
    # Its own error is told, in one line.
    controller.error, controller.text = 7, b"drive 2 is\n hot"
    drive(control, robot, 2)
    assert control.fault == "error 7: drive 2 is? hot"


def test_a_loss_is_told_even_if_the_controller_is_back_at_once(controller):
    device = udp_devices.UdpRobot("127.0.0.1:9")
    device.configure()
    device.power_on()
    device.activate()
    controller.answers = False
    for _ in range(MOST_UNANSWERED + 1):
        device.advance(MS)
    controller.restart()
    controller.answers = True
    for _ in range(120):
        device.advance(MS)
        assert device.read().error
        assert controller.state != ACTIVE
    device.deactivate()
    device.activate()
    device.advance(MS)
    assert controller.state == ACTIVE and device.read().error == ""


def joystick_cycles(operation, count, begin=0):
    for cycle in range(count):
        operation.handle_force(1.0, 0.0)
        operation.device.advance(MS)
        operation.handle_reading((begin + cycle) * MS)
    return begin + count


def test_a_joystick_leads_and_after_a_silence_is_calibrated_before_it_leads_again(controller):
    controller.capabilities = PythonController(limits=(0.0,) * 5).capabilities
    device = udp_devices.UdpJoystick("127.0.0.1:9")
    operation = JoystickOperation(device)
    now = joystick_cycles(operation, 400)
    assert operation.state is JoystickState.APPLICATION
    controller.position, controller.detail, controller.buttons = [0.03, -0.02], 2, 5
    now = joystick_cycles(operation, 400, now)
    reading = operation.reading
    assert reading.position(0) == pytest.approx(0.03) and reading.position(1) == pytest.approx(
        -0.02
    )
    assert reading.dead_man and reading.buttons == 5
    assert controller.state == JoystickState.APPLICATION and controller.force == [0.0, 0.0]

    controller.answers = False
    now = joystick_cycles(operation, MOST_UNANSWERED + 5, now)
    assert operation.state is JoystickState.RECOVERABLE and "is silent" in operation.reason
    assert isnan(operation.reading.x_m) and not operation.reading.dead_man
    controller.answers = True
    controller.position = [0.0, 0.0]
    now = joystick_cycles(operation, 2000, now)
    assert operation.state is JoystickState.APPLICATION
    assert operation.force_limit_n == 0.0, "a button that is still held is not a new press"


def test_a_place_that_jumps_is_followed_with_a_hands_acceleration(controller):
    device = udp_devices.UdpJoystick("127.0.0.1:9")
    positions = [0.0]
    controller.position = [0.05, 0.0]
    for _ in range(200):
        device.advance(MS)
        positions.append(device.read().x_m)
    steps = [b - a for a, b in pairwise(positions)]
    changes = [abs(b - a) for a, b in pairwise(steps)]
    assert max(changes) < 150.0 * 1e-6 and max(positions) < 0.0501
    assert positions[-1] == pytest.approx(0.05)

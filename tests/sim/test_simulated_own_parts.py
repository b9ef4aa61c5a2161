"""A user's robot and joystick, or a faulty one, in a whole session on virtual time."""

from user_parts import load

from pipelines.session.setup.setup_file import load_setup
from pipelines.virtual.simulate import simulate
from telepresence.haptics.device.simulated import FAULTS, SimulatedDevice
from telepresence.haptics.robot_device import DrivenRobot

own_robot, own_joystick = load("own_robot.py"), load("own_joystick.py")


class Felt(own_robot.Mass):
    """It remembers how hard it has pushed its wall, and that it is off."""

    most_n, off = 0.0, False

    def read(self):
        reading = super().read()
        self.most_n = max(self.most_n, -reading.push_x_n)
        return reading

    def power_off(self):
        self.off = True


def test_the_hand_leads_the_robot_to_its_wall_at_any_delay():
    robot, joystick = Felt(), own_joystick.HeldLever()
    setup = load_setup("taskboard", changes={"radio_delay_ms": 100})
    report = simulate(
        setup, seconds=6, seed=1, media=False, robot=DrivenRobot(robot), joystick=joystick
    )
    assert report.simulation.robot == "a mass before a wall"
    assert report.joystick.device == "a lever"
    assert 1.0 < robot.most_n <= own_robot.Mass.capabilities.force_limit_n
    assert report.safety.presses == 1


def test_a_failed_calibration_fails_the_session():
    stuck = SimulatedDevice(FAULTS["stuck-x"])
    report = simulate(load_setup("taskboard"), seconds=8, seed=1, media=False, joystick=stuck)
    reason = "joystick: calibration error: axis x moves by ±0 mm"
    assert [failure[: len(reason)] for failure in report.failures] == [reason]
    assert report.joystick.state == "calibration error"

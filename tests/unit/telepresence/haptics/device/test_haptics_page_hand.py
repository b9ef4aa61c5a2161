"""A person at a page moves the robot: passive at any delay, and at rest once the hand is off."""

from math import hypot, pi, sin
from random import Random

import pytest
from haptic_pair import each_cycle

from kontur_av.clock import NS_PER_MS
from telepresence.haptics.bilateral import JoystickSide, RobotSide
from telepresence.haptics.device.handle import OperatedHandle
from telepresence.haptics.device.page import PageDevice, PageInput
from telepresence.haptics.device.states import JoystickState

#: Self-test and calibration take 3.1 s.
READY, TAPS, PRESS, RELEASED, END = 4_000, 5_000, 9_000, 12_000, 16_000


class Seat:
    """Both sides with a delay, and a pointer that sends events at one rate."""

    def __init__(self, delay_ms, *, period_ms=4, mediated=False):
        self.device = PageDevice()
        self.handle = OperatedHandle(self.device)
        self.space = JoystickSide(handle=self.handle, mediated=mediated)
        self.ground = RobotSide(mediated=mediated)
        self.delay_ms, self.period_ms = delay_ms, period_ms
        self.robot = self.ground.robot

    def cycles(self, count):
        for cycle in each_cycle(self.space, self.ground, count=count, delay_ms=self.delay_ms):
            now_ns = cycle * NS_PER_MS
            feedback = self.space.link.latest(now_ns)
            if feedback is not None:
                self.handle.handle_feedback(feedback)
            wall = self.ground.poll_wall(now_ns)
            if wall is not None:
                self.space.handle_wall(wall)
            yield cycle

    def point(self, cycle, x, y):
        if cycle % self.period_ms == 0:
            hand = PageInput(True, x, y, 0, cycle, cycle * NS_PER_MS)
            self.device.handle_input(hand)


def wanted(cycle):
    """Free motion and hard taps on the wall, then a press beyond what the muscles can."""
    t = cycle / 1000
    if cycle < PRESS:
        return 0.6 * sin(2 * pi * 0.7 * t), 0.5 * sin(2 * pi * 0.4 * t)
    return 0.95, 0.1


@pytest.mark.parametrize("delay_ms", [0, 100])
@pytest.mark.parametrize("period_ms", [1, 17])
def test_no_energy_is_made_and_the_press_comes_to_rest(delay_ms, period_ms):
    seat = Seat(delay_ms, period_ms=period_ms)
    joystick, robot = seat.device.joystick, seat.robot
    touches, felt, pushed = 0, [], []
    work_j = flow_j = 0.0
    for cycle in seat.cycles(RELEASED):
        if cycle >= READY:
            seat.point(cycle, *wanted(cycle))
        port = seat.space.controller.port
        if cycle == READY:
            work_j, flow_j = joystick.work_j, port.out_j - port.in_j
        touches += robot.contact
        if cycle >= RELEASED - 1_000:
            felt.append(seat.space.force_x_n)
            pushed.append(robot.force_n)
        for side in (seat.space, seat.ground):
            assert side.controller.least_observed_uj >= -1.0
    ports = [side.controller.port for side in (seat.space, seat.ground)]
    assert sum(port.out_j for port in ports) <= sum(port.in_j for port in ports) + 1e-6
    # What the port counts is what the motors did, but for the last cycle.
    counted_j = ports[0].out_j - ports[0].in_j - flow_j
    assert joystick.work_j - work_j == pytest.approx(counted_j, abs=0.01)
    assert touches > 1_000
    assert max(pushed) > 3.0 and min(felt) < -2.0
    assert max(pushed) - min(pushed) < 0.5 and max(felt) - min(felt) < 0.5


@pytest.mark.parametrize("delay_ms", [0, 100])
@pytest.mark.parametrize("way", ["button", "silence"])
@pytest.mark.parametrize("released", [TAPS + 250, TAPS + 900, RELEASED])
def test_the_robot_comes_to_rest_when_the_hand_is_released(delay_ms, way, released):
    seat = Seat(delay_ms)
    robot, handle = seat.robot, seat.handle
    settled = None
    for cycle in seat.cycles(released + 4_000):
        if READY <= cycle < released:
            seat.point(cycle, *wanted(cycle))
            assert handle.dead_man or cycle < READY + 2
        elif cycle == released and way == "button":
            seat.device.handle_input(PageInput(False, 0.9, 0.9, 0, cycle, cycle * NS_PER_MS))
        if cycle > released + 101:
            assert not handle.dead_man and handle.force_limit_n == 0.0
        if cycle == released + 1_500 + 2 * delay_ms:
            settled = robot.x_m, robot.y_m
        elif settled is not None:
            # A pressed wall pushes the tip back a little.
            assert hypot(robot.x_m - settled[0], robot.y_m - settled[1]) < 0.002
    assert hypot(robot.vx_m_s, robot.vy_m_s) < 1e-3 and robot.force_n < 0.1
    assert handle.operation.state is JoystickState.APPLICATION


def test_no_input_moves_the_robot_without_the_dead_man_button():
    seat, random = Seat(10), Random(7)
    wild = [0.0, 1.0, -1.0, 2.0, 1e300, float("nan"), float("inf"), -float("inf")]
    old = [PageInput(True, 0.1 * k, 0.0, 0, k, k) for k in range(9)]
    before = None
    for cycle in seat.cycles(9_000):
        if cycle == 3_900:
            for hand in old:
                seat.device.handle_input(hand)
            seat.device.handle_input(PageInput(False, 0.0, 0.0, 0, 9, 9))
        elif cycle >= READY:
            x, y = random.choice(wild), random.choice(wild)
            off = PageInput(False, x, y, 15, random.randrange(1 << 32), cycle * NS_PER_MS)
            stray = PageInput(True, 3.0 * x or 2.0, y, 15, cycle, cycle * NS_PER_MS)
            late = PageInput(True, 0.5, 0.5, 0, cycle, cycle * NS_PER_MS)
            seat.device.handle_input(random.choice([off, stray, random.choice(old)]))
            seat.device.handle_input(late, random.randrange(100, 10_000) * NS_PER_MS)
            assert not seat.handle.dead_man
        if cycle == READY + 500:
            before = seat.robot.x_m, seat.robot.y_m
    assert before is not None
    assert (seat.robot.x_m, seat.robot.y_m) == pytest.approx(before, abs=1e-6)


def test_a_mediated_wall_is_felt_in_a_pages_hand():
    seat = Seat(100, mediated=True)
    felt = []
    for cycle in seat.cycles(RELEASED):
        if cycle >= READY:
            seat.point(cycle, *wanted(cycle))
        felt.append(seat.space.force_x_n)
    assert min(felt[PRESS:]) < -2.0
    assert max(felt[-500:]) - min(felt[-500:]) < 0.5
    for side in (seat.space, seat.ground):
        assert side.controller.least_observed_uj >= -1.0

"""Both controllers treat their two axes alike."""

from random import Random

from telepresence.haptics.joystick_controller import JoystickController
from telepresence.haptics.robot_controller import RobotController
from telepresence.haptics.sample import Command, Feedback

MS = 1_000_000


def walk(seed, cycles=3000):
    """Yield a place (m) that wanders as a hand does, and its velocity (m/s), of one axis."""
    random, place, speed = Random(seed), 0.0, 0.0
    for _ in range(cycles):
        speed += random.uniform(-0.01, 0.01) - 0.002 * speed - 0.02 * place
        place += speed / 1000
        yield place, speed


def test_exchanged_axes_exchange_the_forces_on_the_tip():
    upright, turned = RobotController(), RobotController()
    hand_and_tip = zip(*(walk(seed) for seed in range(4)), strict=True)
    largest_n = 0.0
    for cycle, ((hand_x, _), (hand_y, _), (x, vx), (y, vy)) in enumerate(hand_and_tip):
        total = 20 * cycle
        fx, fy = upright.step(Command(hand_x, hand_y, total), x, y, vx, vy, MS)
        gx, gy = turned.step(Command(hand_y, hand_x, total), y, x, vy, vx, MS)
        assert abs(fx - gy) < 1e-9 and abs(fy - gx) < 1e-9
        largest_n = max(largest_n, abs(fx))
    assert upright.acted > 100 and largest_n > 3


def test_exchanged_axes_exchange_the_forces_on_the_handle():
    upright, turned = JoystickController(), JoystickController()
    wall = zip(*(walk(seed) for seed in range(4)), strict=True)
    largest_n = 0.0
    for cycle, ((x, _), (y, _), (force_x, _), (force_y, _)) in enumerate(wall):
        total = 20 * cycle
        fx, fy = upright.step(Feedback(100 * force_x, 100 * force_y, total, True), x, y, MS)
        gx, gy = turned.step(Feedback(100 * force_y, 100 * force_x, total, True), y, x, MS)
        assert abs(fx - gy) < 1e-9 and abs(fy - gx) < 1e-9
        largest_n = max(largest_n, abs(fx))
    assert largest_n > 1

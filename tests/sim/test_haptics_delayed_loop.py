"""Joystick and robot through a delay, on virtual time: the touch is felt and stays calm."""

from collections import deque

import pytest

from telepresence.haptics.joystick import Joystick
from telepresence.haptics.latency import LatencyMatcher
from telepresence.haptics.loop import joystick_link, robot_link
from telepresence.haptics.robot import Robot

MS = 1_000_000


class Session:
    """Both ends, and a path that takes `delay_ms` each way and is cut while `cut` is true."""

    def __init__(self, delay_ms: int) -> None:
        self.joystick, self.robot = Joystick(), Robot(x_m=-0.06, y_m=0.01)
        self.space, self.ground = joystick_link(), robot_link()
        self.delay_ns = delay_ms * MS
        self.down: deque[tuple[int, bytes]] = deque()
        self.up: deque[tuple[int, bytes]] = deque()
        self.now_ns = 0
        self.cut = False

    def cycle(self) -> None:
        now_ns = self.now_ns
        while self.down and self.down[0][0] <= now_ns:
            self.ground.handle_datagram(self.down.popleft()[1], now_ns)
        while self.up and self.up[0][0] <= now_ns:
            self.space.handle_datagram(self.up.popleft()[1], now_ns)
        self.ground.handle_local(self.robot.step(self.ground.latest(now_ns), MS), now_ns)
        self.space.handle_local(self.joystick.step(self.space.latest(now_ns), MS), now_ns)
        command, feedback = self.space.poll_transmit(now_ns), self.ground.poll_transmit(now_ns)
        assert command is not None
        assert feedback is not None
        if not self.cut:
            self.down.append((now_ns + self.delay_ns, command))
            self.up.append((now_ns + self.delay_ns, feedback))
        self.now_ns += MS


@pytest.mark.parametrize("delay_ms", [1, 10, 25, 50])
def test_one_calm_contact_a_period_that_passes_all_three_targets(delay_ms: int) -> None:
    session = Session(delay_ms)
    begins, touched_y, forces = 0, [], []
    period_ms = session.joystick.period_ns // MS
    for _ in range(period_ms):
        before = session.robot.contact
        session.cycle()
        begins += session.robot.contact and not before
        forces.append(session.robot.force_n)
        if session.robot.contact:
            touched_y.append(session.robot.y_m)
    assert begins == 1
    assert 4.0 < max(forces) < 10.0
    # While the hand stays on the first target the force must settle, whatever the delay.
    settled = forces[3_550:3_750]
    assert max(settled) - min(settled) < 0.1
    for target_y_m in (-0.05, 0.0, 0.05):
        assert min(abs(y - target_y_m) for y in touched_y) < 1e-3


def test_the_press_is_felt() -> None:
    session = Session(10)
    for _ in range(3_700):
        session.cycle()
    assert session.robot.contact
    assert session.joystick.motor_x_n == pytest.approx(-0.5 * session.robot.force_n, abs=0.01)
    to_x, _ = session.joystick.intention()
    assert session.joystick.x_m < to_x - 0.005


def test_an_outage_in_the_press_ends_at_rest_and_resumes_without_a_jump() -> None:
    session = Session(10)
    for _ in range(3_400):
        session.cycle()
    assert session.robot.force_n > 5.0
    session.cut = True
    for _ in range(1_500):
        session.cycle()
    assert session.robot.force_n < 0.1
    assert abs(session.joystick.motor_x_n) < 0.01

    session.cut = False
    for _ in range(1_000):
        before = session.robot.x_m, session.robot.y_m, session.joystick.motor_x_n
        session.cycle()
        assert abs(session.robot.x_m - before[0]) < 0.6e-3
        assert abs(session.robot.y_m - before[1]) < 0.6e-3
        assert abs(session.joystick.motor_x_n - before[2]) <= 1.0 + 1e-9
    assert session.robot.contact
    assert session.ground.report()["lost"] == 1_500


def test_every_samples_delay_is_met_through_more_than_one_wrap() -> None:
    session, matcher = Session(25), LatencyMatcher()
    latencies: list[int] = []
    for cycle in range(70_000):
        session.cycle()
        if cycle % 1000 == 999:
            matcher.handle_received(session.ground.take_received_stamps())
            matcher.handle_sent(session.space.take_sent_stamps())
            latencies += matcher.take_latencies_ns(session.now_ns)
            session.space.take_received_stamps()
            session.ground.take_sent_stamps()
    assert len(latencies) == 70_000 - 25
    assert set(latencies) == {25 * MS}
    assert matcher.unmatched == 0

"""Joystick and robot with a delay, on virtual time: the contact is felt and remains stable."""

from collections import deque
from itertools import pairwise
from math import hypot

import pytest
from haptic_samples import unpack_command, unpack_feedback
from haptic_session import begin_session

from telepresence.haptics.bilateral import JoystickSide, RobotSide
from telepresence.haptics.hand import PRESS_AND_SLIDE, TAP_TARGETS, Waypoint
from telepresence.haptics.latency import LatencyMatcher
from telepresence.haptics.loop import joystick_link
from telepresence.haptics.sample import (
    MODE_IMPEDANCE,
    MODE_POSITION,
    STATE_HALTED,
    Command,
    Feedback,
    pack_command,
)

MS = 1_000_000


class Session:
    """Both sides, and a path that takes `delay_ms` each way and is cut while `cut` is true."""

    def __init__(
        self,
        delay_ms: int,
        *,
        script: tuple[Waypoint, ...] = TAP_TARGETS,
        passive: bool = True,
    ) -> None:
        self.space = JoystickSide(script=script, passive=passive)
        self.ground = RobotSide(passive=passive)
        self.delay_ns = delay_ms * MS
        self.down: deque[tuple[int, bytes]] = deque()
        self.up: deque[tuple[int, bytes]] = deque()
        self.now_ns = 0
        self.cut = False
        self.newest = (b"", b"")

    @property
    def felt_n(self) -> float:
        return hypot(self.space.force_x_n, self.space.force_y_n)

    def cycle(self) -> None:
        now_ns = self.now_ns
        while self.down and self.down[0][0] <= now_ns:
            self.ground.handle_datagram(self.down.popleft()[1], now_ns)
        while self.up and self.up[0][0] <= now_ns:
            self.space.handle_datagram(self.up.popleft()[1], now_ns)
        self.ground.handle_cycle(now_ns, MS)
        self.space.handle_cycle(now_ns, MS)
        command, feedback = self.space.poll_transmit(now_ns), self.ground.poll_transmit(now_ns)
        assert command is not None
        assert feedback is not None
        self.newest = command, feedback
        if not self.cut:
            self.down.append((now_ns + self.delay_ns, command))
            self.up.append((now_ns + self.delay_ns, feedback))
        self.now_ns += MS

    def run(self, cycles: int) -> None:
        for _ in range(cycles):
            self.cycle()


@pytest.mark.parametrize("delay_ms", [0, 1, 10, 25, 150])
def test_each_tap_touches_its_target_once(delay_ms: int) -> None:
    session = Session(delay_ms)
    robot = session.ground.robot
    begins: list[int | None] = []
    forces = []
    for _ in range(16_000 + 2 * delay_ms):
        before = robot.contact
        session.cycle()
        forces.append(robot.force_n)
        if robot.contact and not before:
            begins.append(session.ground.lit)
    assert begins == [0, 1, 2, 1, 0, 1, 2, 1]
    assert 3.0 < max(forces) < 15.0
    for side in (session.ground, session.space):
        assert side.controller.least_observed_uj >= -1.0


def test_the_press_is_felt() -> None:
    session = Session(10, script=PRESS_AND_SLIDE)
    session.run(3_700)
    robot = session.ground.robot
    assert robot.contact
    assert session.space.force_x_n == pytest.approx(-robot.force_n, rel=0.1)
    assert robot.force_n > 3.0
    sample = unpack_feedback(session.newest[1]).value
    assert (sample.contact, sample.lit, sample.mode) == (True, 0, MODE_IMPEDANCE)


def test_only_with_the_controllers_a_contact_at_25_ms_delay_comes_to_rest() -> None:
    script = (Waypoint(0.085, -0.05, 1_000 * MS, 60_000 * MS), Waypoint(0.0, -0.05, 500 * MS, 0))
    swings = []
    for passive in (False, True):
        session = Session(25, script=script, passive=passive)
        session.run(5_000)
        forces = []
        for _ in range(1_000):
            session.cycle()
            forces.append(session.ground.robot.force_n)
        swings.append(max(forces) - min(forces))
    assert swings[0] > 10.0
    assert swings[1] < 0.2


def test_an_outage_during_contact_ends_at_rest_and_resumes_without_a_jump() -> None:
    session = Session(10, script=PRESS_AND_SLIDE)
    session.run(3_400)
    robot = session.ground.robot
    assert robot.force_n > 3.0
    session.cut = True
    session.run(1_500)
    assert session.ground.controller.holding
    assert robot.force_n < 0.2
    # Only the damping of the hand's motion remains.
    assert session.felt_n < 0.1 + session.space.controller.model.damping_n_s_m * 0.15

    session.cut = False
    felt, references = [session.felt_n], []
    for _ in range(1_000):
        session.cycle()
        felt.append(session.felt_n)
        references.append(session.ground.controller.reference_x_m)
    most_n = session.space.controller.model.rate_n_s / 1000
    assert max(later - earlier for earlier, later in pairwise(felt)) <= most_n * 1.3
    most_m = session.ground.controller.model.speed_m_s / 1000
    assert max(abs(b - a) for a, b in pairwise(references)) <= most_m + 1e-9
    assert robot.contact
    assert session.ground.link.lost == 1_500


def test_a_restarted_joystick_begins_without_credit_and_continues() -> None:
    session = Session(5)
    session.run(2_000)
    before = session.ground.controller.port.received_j
    session.space = JoystickSide(link=joystick_link(life=2))
    lit = set()
    for _ in range(8_000):
        session.cycle()
        lit.add(session.ground.lit)
    assert session.ground.link.restarts == 1
    # The new totals begin at 0, which must not count as a gain.
    assert before < session.ground.controller.port.received_j < before + 2.0
    assert session.ground.controller.least_observed_uj >= -1.0
    assert lit == {None, 0, 1, 2}


def test_a_robot_in_another_mode_displays_no_force_and_stays() -> None:
    session = Session(5, script=PRESS_AND_SLIDE)
    session.run(3_300)
    robot = session.ground.robot
    assert session.felt_n > 2.0
    robot.set_position(robot.x_m, robot.y_m)
    at = robot.x_m, robot.y_m
    session.run(1_000)
    assert (robot.x_m, robot.y_m) == pytest.approx(at, abs=3e-3)
    sample = unpack_feedback(session.newest[1]).value
    assert (sample.mode, sample.halted) == (MODE_POSITION, True)
    assert session.felt_n < 1.0


def test_a_halted_joystick_says_so_and_the_robot_holds() -> None:
    session = Session(5)
    session.run(300)
    session.space.handle.state = STATE_HALTED
    session.space.handle.dead_man = False
    session.run(20)
    command = unpack_command(session.newest[0]).value
    assert (command.halted, command.dead_man, command.state) == (True, False, STATE_HALTED)
    assert session.ground.controller.holding


def test_a_late_cycle_simulates_the_time_in_small_steps() -> None:
    even, late = JoystickSide(), JoystickSide()
    for k in range(40):
        even.handle_cycle(k * MS, MS)
    late.handle_cycle(0, 40 * MS)
    assert (late.handle.x_m, late.handle.y_m) == (even.handle.x_m, even.handle.y_m)
    robot = RobotSide()
    data = pack_command(0, Command(0.05, 0.0, 0), session=begin_session(robot.link))
    robot.handle_datagram(data, 0)
    robot.handle_cycle(0, 3_600_000 * MS)
    assert abs(robot.robot.x_m) < 0.06
    assert isinstance(robot.link.latest(0), Command)
    assert not isinstance(robot.link.latest(0), Feedback)


def test_delays_are_matched_through_several_wraps() -> None:
    session, matcher = Session(25), LatencyMatcher()
    latencies: list[int] = []
    for cycle in range(70_000):
        session.cycle()
        if cycle % 1000 == 999:
            matcher.handle_received(session.ground.link.take_received_stamps())
            matcher.handle_sent(session.space.link.take_sent_stamps())
            latencies += [ns for _, ns in matcher.take_matches_ns(session.now_ns)]
            session.space.link.take_received_stamps()
            session.ground.link.take_sent_stamps()
    # Greetings begin the session, and renew it twice.
    assert len(latencies) + session.ground.link.greetings == 70_000 - 25
    assert 0 < session.ground.link.greetings < 100
    assert session.ground.link.sessions == session.space.link.sessions == 3
    assert session.ground.link.lost == session.space.link.lost == session.ground.link.strays == 0
    assert set(latencies) == {25 * MS}
    assert matcher.unmatched == 0

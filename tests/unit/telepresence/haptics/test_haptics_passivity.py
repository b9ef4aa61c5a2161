"""For any motion and any loss of samples, no port gives out energy that was not granted."""

from collections.abc import Callable
from itertools import pairwise
from math import inf
from random import Random

import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from telepresence.haptics.joystick_controller import JoystickController, JoystickControllerModel
from telepresence.haptics.loop import joystick_link, robot_link
from telepresence.haptics.passivity import Port
from telepresence.haptics.robot_controller import RobotController
from telepresence.haptics.sample import Command, Feedback

MS = 1_000_000
DT = 1e-3
#: One count of the energy in a sample.
COUNT_J = 1e-6

unit = st.floats(-1.0, 1.0)
#: Each span lasts some ms with one acceleration of the hand and one motion of the tip. The path
#: delays each sample by up to some ms, and loses a share of them.
spans = st.tuples(
    st.integers(1, 100),
    st.tuples(unit, unit),
    st.tuples(unit, unit),
    st.tuples(unit, unit),
    st.integers(0, 80),
    st.sampled_from([0.0, 0.0, 0.3, 1.0]),
)


class Ends:
    """Both controllers; hand and tip move as they are told, whatever the forces are."""

    def __init__(self, random: Callable[[], float]) -> None:
        self.random = random
        self.joystick_side, self.robot_side = JoystickController(), RobotController()
        self.space, self.ground = joystick_link(), robot_link()
        self.hand, self.tip = [0.0, 0.0, 0.0, 0.0], [0.0, 0.0]
        self.push = (0.0, 0.0)
        self.path: list[tuple[int, int, bytes]] = []
        self.now_ns = 0
        #: Energy into and out of both ports in all their lives, also those that have ended.
        self.taken_j = self.given_j = 0.0

    def restart_joystick(self) -> None:
        self._end(self.joystick_side)
        self.joystick_side, self.space = JoystickController(), joystick_link()

    def restart_robot(self) -> None:
        self._end(self.robot_side)
        self.robot_side, self.ground = (
            RobotController(x_m=self.tip[0], y_m=self.tip[1]),
            robot_link(),
        )

    def _end(self, controller: JoystickController | RobotController) -> None:
        self.taken_j += controller.port.in_j
        self.given_j += controller.port.out_j

    def cycle(
        self,
        pull: tuple[float, float],
        tip: tuple[float, float],
        delay_ms: int,
        loss: float,
    ) -> None:
        now_ns = self.now_ns
        due = [sample for sample in self.path if sample[0] <= now_ns]
        self.path = [sample for sample in self.path if sample[0] > now_ns]
        for _, to, data in sorted(due, key=lambda sample: sample[0]):
            (self.ground if to else self.space).handle_datagram(data, now_ns)
        hand = self.hand
        # The greatest acceleration that the controller allows for, in any direction.
        most = JoystickControllerModel().acceleration_m_s2 / 2**0.5
        for axis in (0, 1):
            hand[2 + axis] += pull[axis] * most * DT
            if abs(hand[axis]) > 0.12 and hand[axis] * hand[2 + axis] > 0:
                hand[2 + axis] -= max(-most * DT, min(most * DT, hand[2 + axis]))
            hand[2 + axis] = max(-1.5, min(1.5, hand[2 + axis]))
            hand[axis] += hand[2 + axis] * DT
            self.tip[axis] += tip[axis] * DT
        self.joystick_side.step(self.space.latest(now_ns), hand[0], hand[1], MS)
        self.robot_side.step(self.ground.latest(now_ns), *self.tip, *tip, MS)
        self.space.handle_local(Command(hand[0], hand[1], self.joystick_side.granted_uj), now_ns)
        self.ground.handle_local(Feedback(*self.push, self.robot_side.granted_uj, True), now_ns)
        for to, link in ((1, self.space), (0, self.ground)):
            data = link.poll_transmit(now_ns)
            assert data is not None
            if self.random() >= loss:
                self.path.append((now_ns + round(self.random() * delay_ms * MS), to, data))
        self.now_ns += MS

    def check(self) -> None:
        assert self.joystick_side.port.credit_j >= -COUNT_J
        assert self.robot_side.port.credit_j >= -COUNT_J
        taken_j = self.taken_j + self.joystick_side.port.in_j + self.robot_side.port.in_j
        given_j = self.given_j + self.joystick_side.port.out_j + self.robot_side.port.out_j
        assert given_j <= taken_j + COUNT_J


@settings(max_examples=50, deadline=None)
@example(
    # The joystick restarts while the hand moves: its first force must allow for that.
    spans=[
        (3, (0.0, 1.0), (0.0, 0.0), (0.0, 1.0), 0, 0.0),
        (2, (0.0, 0.0), (0.0, 0.0), (0.0, 0.0), 0, 0.0),
    ],
    random=Random(1),
    restart=(1, True),
)
@given(
    spans=st.lists(spans, min_size=1, max_size=8),
    random=st.randoms(use_true_random=False),
    restart=st.none() | st.tuples(st.integers(0, 7), st.booleans()),
)
def test_no_motion_and_no_path_makes_an_observer_negative(spans, random, restart) -> None:
    ends = Ends(random.random)
    for index, (cycles, pull, tip, push, delay_ms, loss) in enumerate(spans):
        if restart is not None and restart[0] == index:
            (ends.restart_joystick if restart[1] else ends.restart_robot)()
        ends.push = (push[0] * 60.0, push[1] * 60.0)
        for _ in range(cycles):
            ends.cycle(pull, tip, delay_ms, loss)
            ends.check()


def test_one_sample_heals_any_loss() -> None:
    whole, torn = Port(), Port()
    total_uj = 0
    whole.handle_total(0, MS)
    torn.handle_total(0, MS)
    for k in range(300):
        total_uj += 37 * (k % 7)
        whole.handle_total(total_uj, MS)
        if k < 299:
            torn.handle_silence(MS)
        else:
            torn.handle_total(total_uj, MS)
    assert torn.credit_j == pytest.approx(whole.credit_j) == pytest.approx(total_uj * 1e-6)


@pytest.mark.parametrize("jump_uj", [-1, -5_000_000, 20_000_000, 1 << 31])
def test_an_implausible_total_gives_no_credit(jump_uj: int) -> None:
    port = Port()
    port.handle_total(50_000_000, MS)
    for _ in range(5):
        port.handle_total(50_000_000 + jump_uj, MS)
    assert (port.credit_j, port.refused) == (0.0, 1)
    # Counting continues from the highest total that counted.
    port.handle_total(50_000_010, MS)
    assert port.credit_j == pytest.approx(10e-6)


def test_totals_that_alternate_gain_nothing() -> None:
    port = Port(limit_j=inf)
    for k in range(1000):
        port.handle_total(5_000_000 * (k % 2), MS)
    assert port.received_j == pytest.approx(5.0)
    assert port.refused > 0


def test_a_total_grows_no_faster_than_the_peers_power() -> None:
    """A token bucket: 6 J at once, and 60 W over any time."""
    port = Port(limit_j=inf)
    port.handle_total(0, MS)
    for k in range(1, 1001):
        port.handle_total(round(port.received_j * 1e6) + 6_000_000 - 5_940_000 * (k % 2), MS)
        assert port.received_j <= 6.0 + 60.0 * (k + 1) / 1000 + COUNT_J
    assert port.received_j > 6.0


def test_a_gain_after_a_silence_or_beyond_the_bucket_counts_when_there_was_time_for_it() -> None:
    port = Port(limit_j=inf)
    port.handle_total(0, MS)
    port.handle_silence(1000 * MS)
    port.handle_total(60_000_000, MS)
    assert port.received_j == pytest.approx(60.0)
    waited = 0
    while port.received_j < 80.0 - COUNT_J:
        port.handle_total(80_000_000, MS)
        waited += 1
    assert 20.0 - 6.1 < waited * 0.06 < 20.0 + 0.1


def test_kept_energy_is_not_granted_and_credit_is_limited() -> None:
    port = Port(reserve_j=0.004, limit_j=0.5)
    port.handle_flow(-0.003)
    assert (port.credit_j, port.granted_uj) == (pytest.approx(0.003), 0)
    port.handle_flow(-0.003)
    assert (port.credit_j, port.granted_uj) == (pytest.approx(0.004), 2000)
    port.handle_flow(0.001)
    assert port.kept_j + port.granted_j == pytest.approx(port.in_j)
    port.handle_total(0, MS)
    port.handle_total(900_000, 100 * MS)
    assert port.credit_j == 0.5
    assert port.received_j - port.forgotten_j + port.kept_j - port.out_j == pytest.approx(0.5)


def test_without_the_controllers_the_observers_only_observe() -> None:
    robot_side = RobotController(passive=False)
    for k in range(200):
        robot_side.step(Command(1e-4 * k, 0.0, 0), 0.0, 0.0, 0.0, 0.0, MS)
    assert robot_side.credit_uj < -10_000
    assert robot_side.least_observed_uj == robot_side.credit_uj
    assert robot_side.acted == 0
    held = RobotController()
    for k in range(200):
        held.step(Command(1e-4 * k, 0.0, 0), 0.0, 0.0, 0.0, 0.0, MS)
    assert held.reference_x_m == 0.0
    assert held.acted > 150


@pytest.mark.parametrize("limit_m_s", [0.5, 0.2])
def test_the_reference_catches_up_at_a_bounded_speed(limit_m_s: float) -> None:
    robot_side = RobotController()
    robot_side.speed_m_s = limit_m_s
    x_m, v_m_s, places, tips = 0.0, 0.0, [], []
    for k in range(1500):
        # Nothing is granted in the first 500 ms, then more than enough.
        granted_uj = 0 if k < 500 else (k - 499) * 2000
        force, _ = robot_side.step(Command(0.1, 0.0, granted_uj), x_m, 0.0, v_m_s, 0.0, MS)
        v_m_s += force / 0.5 * DT
        x_m += v_m_s * DT
        places.append(robot_side.reference_x_m)
        tips.append(v_m_s)
    assert places[499] == 0.0
    assert places[-1] == pytest.approx(0.1, abs=1e-4)
    # Nor does the tip overshoot that speed.
    assert 0.9 * limit_m_s < max(tips) <= limit_m_s
    speeds = [(b - a) / DT for a, b in pairwise(places)]
    assert 0.1 < max(speeds) <= limit_m_s + 1e-9


@pytest.mark.parametrize("limit_m_s", [0.5, 0.2, 0.1, 0.03])
def test_no_limit_of_speed_makes_a_step_of_the_force(limit_m_s: float) -> None:
    command, forces = Command(0.05, 0.0, 0), []
    for k in range(101):
        robot_side = RobotController(passive=False)
        robot_side.speed_m_s, robot_side.reference_x_m = limit_m_s, 0.02
        v_m_s = limit_m_s * k / 100
        forces.append(robot_side.step(command, 0.0, 0.0, v_m_s, 0.0, MS)[0])
    assert forces[0] > 20.0
    assert max(abs(b - a) for a, b in pairwise(forces)) < 300.0 * limit_m_s / 100

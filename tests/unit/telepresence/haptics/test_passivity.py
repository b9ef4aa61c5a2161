"""The books of a port balance, and no motion and no path lets a port give out what it lacks."""

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
#: One count of the energy in a sample.
COUNT_J = 1e-6
flows = st.one_of(
    st.tuples(st.just("flow"), st.floats(-0.01, 0.01)),
    st.tuples(st.just("total"), st.integers(0, 20_000)),
    st.tuples(st.just("return"), st.floats(0.0, 0.002)),
)


@given(st.lists(flows, max_size=60), st.sampled_from([0.0, 0.004]), st.sampled_from([0.01, inf]))
def test_every_joule_of_a_port_is_in_one_place(script, reserve_j, limit_j):
    port = Port(reserve_j=reserve_j, limit_j=limit_j)
    total_uj = 0
    port.handle_total(total_uj, MS)
    in_j = out_j = told_j = returned_j = 0.0
    least_j = 0.0
    for kind, amount in script:
        if kind == "flow":
            port.handle_flow(amount)
            out_j += max(amount, 0.0)
            in_j += max(-amount, 0.0)
            if amount > 0.0:
                least_j = min(least_j, port.credit_j)
        elif kind == "total":
            total_uj += amount
            port.handle_total(total_uj, 100 * MS)
            told_j += amount * 1e-6
        else:
            port.return_credit(amount)
            returned_j += amount
        credit_j = port.received_j + port.kept_j - port.forgotten_j - port.returned_j - port.out_j
        assert port.credit_j == pytest.approx(credit_j, abs=1e-12)
        assert port.credit_j <= max(limit_j, reserve_j) + 1e-12
    assert (port.in_j, port.out_j) == pytest.approx((in_j, out_j), abs=1e-12)
    assert (port.received_j, port.returned_j) == pytest.approx((told_j, returned_j), abs=1e-9)
    # What entered is kept here or granted to the peer; what is returned is granted as well.
    assert port.granted_j == pytest.approx(in_j - port.kept_j + returned_j, abs=1e-12)
    assert port.granted_uj == int(port.granted_j * 1e6)
    assert port.least_j == pytest.approx(least_j, abs=1e-12)
    assert min(port.kept_j, port.forgotten_j) >= 0.0
    assert port.refused == 0


def test_incoming_energy_fills_the_reserve_and_only_the_rest_is_granted():
    port = Port(reserve_j=0.004, limit_j=0.5)
    for kept_j, granted_uj in ((0.003, 0), (0.004, 2000), (0.004, 5000)):
        port.handle_flow(-0.003)
        assert (port.kept_j, port.credit_j) == pytest.approx((kept_j, kept_j))
        assert port.granted_uj == granted_uj
    # Credit is limited.
    port.handle_total(0, MS)
    port.handle_total(900_000, 100 * MS)
    assert port.credit_j == 0.5


def test_one_sample_heals_any_loss():
    whole, torn = Port(), Port()
    total_uj = 0
    for k in range(300):
        total_uj += 37 * (k % 7)
        whole.handle_total(total_uj, MS)
        if k in (0, 299):
            torn.handle_total(total_uj, MS)
        else:
            torn.handle_silence(MS)
    assert torn.credit_j == pytest.approx(whole.credit_j) == pytest.approx(total_uj * 1e-6)


@pytest.mark.parametrize("jump_uj", [-1, -5_000_000, 20_000_000, 1 << 31])
def test_an_implausible_total_gives_no_credit(jump_uj):
    port = Port()
    port.handle_total(50_000_000, MS)
    for _ in range(5):
        port.handle_total(50_000_000 + jump_uj, MS)
    assert (port.credit_j, port.refused) == (0.0, 1)
    # Counting continues from the highest total that counted.
    port.handle_total(50_000_010, MS)
    assert port.credit_j == pytest.approx(10e-6)


def test_a_total_grows_no_faster_than_the_peers_power():
    """A token bucket: 6 J at once, and 60 W over any time."""
    port = Port(limit_j=inf)
    port.handle_total(0, MS)
    for k in range(1, 1001):
        port.handle_total(round(port.received_j * 1e6) + 6_000_000 - 5_940_000 * (k % 2), MS)
        assert port.received_j <= 6.0 + 60.0 * (k + 1) / 1000 + COUNT_J
    assert port.received_j > 6.0
    # Totals that alternate gain nothing.
    port = Port(limit_j=inf)
    for k in range(1000):
        port.handle_total(5_000_000 * (k % 2), MS)
    assert port.received_j == pytest.approx(5.0) and port.refused > 0


def test_a_gain_after_a_silence_or_beyond_the_bucket_counts_when_there_was_time_for_it():
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

    def __init__(self, random):
        self.random = random
        self.joystick_side, self.robot_side = JoystickController(), RobotController()
        self.space, self.ground = joystick_link(), robot_link()
        self.hand, self.tip = [0.0, 0.0, 0.0, 0.0], [0.0, 0.0]
        self.push = (0.0, 0.0)
        self.path = []
        self.now_ns = 0
        #: Energy into and out of both ports in all their lives, also those that have ended.
        self.taken_j = self.given_j = 0.0

    def restart(self, joystick):
        port = (self.joystick_side if joystick else self.robot_side).port
        self.taken_j += port.in_j
        self.given_j += port.out_j
        if joystick:
            self.joystick_side, self.space = JoystickController(), joystick_link()
        else:
            self.robot_side = RobotController(x_m=self.tip[0], y_m=self.tip[1])
            self.ground = robot_link()

    def cycle(self, pull, tip, delay_ms, loss):
        now_ns, hand = self.now_ns, self.hand
        due = [sample for sample in self.path if sample[0] <= now_ns]
        self.path = [sample for sample in self.path if sample[0] > now_ns]
        for _, to, data in sorted(due, key=lambda sample: sample[0]):
            (self.ground if to else self.space).handle_datagram(data, now_ns)
        # The greatest acceleration that the controller allows for, in any direction.
        most = JoystickControllerModel().acceleration_m_s2 / 2**0.5
        for axis in (0, 1):
            hand[2 + axis] += pull[axis] * most * 1e-3
            if abs(hand[axis]) > 0.12 and hand[axis] * hand[2 + axis] > 0:
                hand[2 + axis] -= max(-most * 1e-3, min(most * 1e-3, hand[2 + axis]))
            hand[2 + axis] = max(-1.5, min(1.5, hand[2 + axis]))
            hand[axis] += hand[2 + axis] * 1e-3
            self.tip[axis] += tip[axis] * 1e-3
        self.joystick_side.step(self.space.latest(now_ns), hand[0], hand[1], MS)
        self.robot_side.step(self.ground.latest(now_ns), *self.tip, *tip, MS)
        self.space.handle_local(
            Command(hand[0], hand[1], self.joystick_side.port.granted_uj), now_ns
        )
        self.ground.handle_local(
            Feedback(*self.push, self.robot_side.port.granted_uj, True), now_ns
        )
        for to, link in ((1, self.space), (0, self.ground)):
            data = link.poll_transmit(now_ns)
            if self.random() >= loss:
                self.path.append((now_ns + round(self.random() * delay_ms * MS), to, data))
        self.now_ns += MS

    def check(self):
        ports = self.joystick_side.port, self.robot_side.port
        assert min(port.credit_j for port in ports) >= -COUNT_J
        taken_j = self.taken_j + sum(port.in_j for port in ports)
        assert self.given_j + sum(port.out_j for port in ports) <= taken_j + COUNT_J


@settings(max_examples=50)
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
def test_no_motion_and_no_path_makes_an_observer_negative(spans, random, restart):
    ends = Ends(random.random)
    for index, (cycles, pull, tip, push, delay_ms, loss) in enumerate(spans):
        if restart is not None and restart[0] == index:
            ends.restart(restart[1])
        ends.push = (push[0] * 60.0, push[1] * 60.0)
        for _ in range(cycles):
            ends.cycle(pull, tip, delay_ms, loss)
            ends.check()

"""Joystick and robot of a session on virtual time, with the partner's robot of the Russian part."""

import random
from collections import deque
from copy import deepcopy

import pytest

from kontur_av.clock import NS_PER_MS as MS
from pipelines.hand.haptics import JoystickEnd, RobotEnd, robot_side
from pipelines.hand.robot_commands import RobotCommands
from pipelines.session.mission_messages import RobotCommand
from pipelines.session.probe import Probe
from telepresence.haptics.authority import Authority, ControlAuthority, PartnerBoard
from telepresence.haptics.device.handle import OperatedHandle
from telepresence.haptics.device.simulated import SimulatedDevice
from telepresence.haptics.device.states import ExperimentName, JoystickEvent, JoystickState
from telepresence.haptics.envelope import SafetyEnvelope
from telepresence.haptics.hand import Hand
from telepresence.haptics.sample import Feedback, pack_feedback

GERMAN, RUSSIAN = JoystickEvent.START, JoystickEvent.START_RUSSIAN


class Way:
    """Datagrams that arrive a while later."""

    def __init__(self, delay_ms):
        self._delay_ns, self._under_way = delay_ms * MS, deque()

    def send(self, data, now_ns):
        if data is not None:
            self._under_way.append((now_ns + self._delay_ns, data))

    def take(self, now_ns):
        while self._under_way and self._under_way[0][0] <= now_ns:
            yield self._under_way.popleft()[1]


class Bench:
    """All three ends. The simulated hand lets go and presses whenever the robot waits for it."""

    def __init__(self):
        self.handle = OperatedHandle(SimulatedDevice(hand=Hand()))
        self.joystick = JoystickEnd(Probe(), boot_id=1, handle=self.handle)
        self.down, self.up = Way(15), Way(15)
        self.there, self.back = Way(8), Way(8)
        #: Whether the partner's robot can be reached; what a partner sends in its place.
        self.partner_runs, self.garbage = True, None
        self.now_ns = 0
        self.start_ground(boot_id=3)
        self.start_partner(boot_id=4)

    def start_ground(self, *, boot_id, orders=None):
        wanted = Authority.PARTNER if orders is not None and orders.board else Authority.OPERATOR
        ownership = ControlAuthority(None, wanted=wanted)
        self.board = board = PartnerBoard(ownership)
        side = robot_side(SafetyEnvelope(), boot_id=boot_id, ownership=ownership)
        self.ours = RobotEnd(Probe(), side, board=board)
        capabilities = {"boot_id": boot_id, "tasks": False, "now_ns": self.now_ns}
        self.service = RobotCommands(self.ours.side, orders=orders, board=board, **capabilities)

    def start_partner(self, *, boot_id):
        self.partner = robot_side(SafetyEnvelope(), boot_id=boot_id)

    def run(self, seconds):
        for _ in range(round(1000 * seconds)):
            self.step()

    def step(self):
        now_ns, joystick, ours, partner = self.now_ns, self.joystick, self.ours, self.partner
        for data in self.up.take(now_ns):
            joystick.handle_datagram(data, now_ns)
        joystick.handle_cycle(now_ns, MS)
        joystick.follow_experiment()
        self.down.send(joystick.poll_transmit(now_ns), now_ns)
        for data in self.down.take(now_ns):
            ours.handle_datagram(data, now_ns)
        for data in self.back.take(now_ns):
            self.board.handle_partner(data, now_ns)
        stopped = ours.envelope.stopped
        self.there.send(self.board.poll_partner(stopped=stopped), now_ns)
        self.service.step(now_ns)
        ours.handle_cycle(now_ns, MS)
        self.up.send(ours.poll_transmit(now_ns), now_ns)
        for data in self.there.take(now_ns):
            if self.partner_runs:
                partner.handle_datagram(data, now_ns)
        if self.partner_runs:
            partner.handle_cycle(now_ns, MS)
            self.back.send(partner.poll_transmit(now_ns), now_ns)
        elif self.garbage is not None:
            self.back.send(self.garbage(), now_ns)
        self.now_ns += MS

    def ask(self, event):
        refusal = self.handle.handle_command(event)
        self.joystick.follow_experiment()
        return refusal

    def switch(self, event):
        assert self.ask(JoystickEvent.STOP) == self.ask(event) == ""

    def ways(self, seconds):
        """How far our tip and the partner's go meanwhile (m), and the most force felt (N)."""
        robots = (self.ours.side.robot, self.partner.robot)
        ways, force = [0.0, 0.0], 0.0
        for _ in range(round(1000 * seconds)):
            before = [(robot.x_m, robot.y_m) for robot in robots]
            self.step()
            for index, (one, (x, y)) in enumerate(zip(robots, before, strict=True)):
                ways[index] += abs(one.x_m - x) + abs(one.y_m - y)
            push = self.joystick.side.controller.robot_force_n
            force = max(force, abs(push[0]) + abs(push[1]))
        return *ways, force


BEGUN = []


@pytest.fixture
def bench():
    """In the application; begun once for all."""
    if not BEGUN:
        first = Bench()
        first.run(9)
        assert first.handle.operation.state is JoystickState.APPLICATION
        BEGUN.append(first)
    return deepcopy(BEGUN[0])


def test_one_robot_at_a_time_follows_the_hand_and_the_port_stays_passive(bench):
    ours, partner, force = bench.ways(4)
    assert ours > 0.02 and partner < 1e-6 and force > 0.5
    for event, mine in ((RUSSIAN, False), (GERMAN, True), (RUSSIAN, False)):
        bench.switch(event)
        # Ours comes to rest, off; the partner's holds its place, on, and yields to the board.
        bench.run(1)
        ours, partner, force = bench.ways(5)
        moved, still = (ours, partner) if mine else (partner, ours)
        assert moved > 0.02 and still < (1e-3 if mine else 1e-5) and force > 0.5, event
        assert bench.service.control.powered is mine
        assert bench.service.status(bench.now_ns).partner == ("ready" if mine else "driven")
        for side in (bench.joystick.side, bench.ours.side, bench.partner):
            assert side.report()[""].least_uj >= -1
    assert bench.board.ownership.report().turns == 4
    # No sample under way was for the other robot.
    assert bench.ours.side.link.counts.lost == bench.joystick.side.link.counts.lost == 0


def test_a_switch_halts_and_needs_a_new_press(bench):
    bench.run(3)
    bench.switch(RUSSIAN)
    # Held all the time, so nobody has pressed anew.
    bench.handle._simulated.handle_robot = lambda *_: None
    held = bench.handle.dead_man
    bench.run(0.5)
    ours, partner, force = bench.ways(3)
    assert held and bench.handle.dead_man
    assert ours < 1e-5 and partner < 1e-5 and force < 0.01
    assert bench.partner.envelope.waiting


def test_the_start_is_refused_without_a_partner(bench):
    bench.partner_runs = False
    bench.run(1)
    assert bench.handle.operation.partner is False
    assert bench.ask(RUSSIAN) == "start_russian: the partner's robot is not there"
    ours, partner, _ = bench.ways(2)
    assert ours > 0.01 and partner == 0.0
    assert bench.handle.operation.experiment is ExperimentName.GERMAN
    alone = OperatedHandle(SimulatedDevice(hand=Hand()))
    assert "partner_arm" in alone.handle_command(RUSSIAN)


def test_a_partner_that_vanishes_leaves_no_force_and_the_german_experiment_can_start(bench):
    bench.switch(RUSSIAN)
    bench.run(4)
    bench.partner_runs = False
    bench.run(1.0)
    ours, _, force = bench.ways(5)
    operation = bench.handle.operation
    assert ours < 1e-6 and force < 0.1
    assert operation.state is JoystickState.HALTED
    assert operation.reason == "no sample from the partner's robot for 5 s"
    assert bench.service.status(bench.now_ns).partner == "absent"
    assert "not there" in bench.ask(RUSSIAN)
    assert bench.ask(GERMAN) == ""
    ours, _, _ = bench.ways(4)
    assert ours > 0.01


@pytest.mark.parametrize("killed", ["ground", "partner"])
def test_a_restarted_end_goes_on_with_the_russian_experiment(bench, killed):
    bench.switch(RUSSIAN)
    bench.run(4)
    orders = bench.service.orders
    assert orders.board and orders.powered
    if killed == "ground":
        bench.start_ground(boot_id=9, orders=orders)
    else:
        bench.start_partner(boot_id=9)
    ours, partner, _ = bench.ways(5)
    assert ours < 1e-6 and partner > 0.01


def test_garbage_of_a_partner_reaches_nobody(bench):
    bench.switch(RUSSIAN)
    bench.run(3)
    random.seed(1)
    bench.partner_runs = False
    bench.garbage = lambda: random.randbytes(random.choice((0, 1, 11, 12, 12, 12, 13, 4000)))
    ours, _, force = bench.ways(2)
    assert ours < 1e-6 and bench.board.ownership.report().garbage > 500
    # What looks like a sample is of no session, and displays nothing.
    assert bench.ways(1)[2] < 0.1 and force < 12.1
    # Well-made samples of another session show nothing either.
    full = Feedback(60.0, 0.0, 10_000_000, True)
    bench.garbage = lambda: pack_feedback(7, full, session=200)
    assert bench.ways(1)[2] < 0.1
    bench.switch(GERMAN)
    assert bench.ways(5)[0] > 0.01


def test_our_robot_cannot_be_switched_on_meanwhile_and_a_stop_here_holds_the_partners(bench):
    bench.switch(RUSSIAN)
    bench.run(4)
    asked = RobotCommand(1, "power_on")
    bench.service.handle_command(asked, bench.now_ns, bench.now_ns)
    refusal = bench.service.status(bench.now_ns).command_refusal
    assert refusal.startswith("the joystick drives the partner's robot")
    bench.ours.envelope.handle_stop(bench.now_ns)
    bench.run(0.2)
    assert max(bench.ways(2)[:2]) < 1e-5
    bench.ours.envelope.handle_stop_released(bench.now_ns)
    assert bench.ways(4)[1] > 0.01
    bench.switch(GERMAN)
    bench.run(1)
    # After an emergency stop somebody must switch it on.
    assert not bench.service.control.powered

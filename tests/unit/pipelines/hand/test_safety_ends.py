"""What the robot knows of the operator's sight, and how each order to stop reaches it."""

from collections import deque
from random import Random

import pytest
from common import first_seed, repeats

from kontur_av.clock import NS_PER_MS as MS
from kontur_av.clock import NS_PER_S
from pipelines.hand.haptics import JoystickEnd, RobotEnd, robot_side
from pipelines.hand.robot_commands import RobotCommands
from pipelines.hand.safety_ends import OperatorView, StopBit
from pipelines.session.probe import Probe
from pipelines.session.setup.setup_file import BUILT_IN
from telepresence.haptics.authority import Authority, ControlAuthority
from telepresence.haptics.device.handle import OperatedHandle
from telepresence.haptics.device.simulated import SimulatedDevice
from telepresence.haptics.envelope import SafetyEnvelope
from telepresence.haptics.hand import Hand
from telepresence.haptics.sample import Command, pack_command

FREE = Command(0.0, 0.0, 0, dead_man=False)


def test_the_robot_counts_a_picture_of_the_future_as_too_old():
    view = OperatorView(BUILT_IN["taskboard"])
    view.handle_shown(NS_PER_S, 40 * MS)
    assert not view.is_blind(NS_PER_S)
    view.handle_shown(NS_PER_S, -3_600 * NS_PER_S)
    assert view.is_blind(NS_PER_S)


@pytest.mark.rule("S5")
def test_the_older_counts_of_what_the_display_and_the_page_have_painted():
    view = OperatorView(BUILT_IN["taskboard"])
    assert view.is_blind(NS_PER_S, painted_ns=NS_PER_S)
    view.handle_shown(NS_PER_S, 40 * MS)
    assert not view.is_blind(NS_PER_S, painted_ns=NS_PER_S - 40 * MS)
    # It paints an old picture, or has painted none.
    assert view.is_blind(NS_PER_S, painted_ns=1) and view.is_blind(NS_PER_S, painted_ns=0)


class TwoMachines:
    """A hand in space that leads a robot on the ground; each machine keeps its own stop."""

    def __init__(self, random, delay_ms, loss):
        self.random, self.delay_ms, self.loss = random, delay_ms, loss
        self.handle = OperatedHandle(SimulatedDevice(hand=Hand()))
        self.joystick = JoystickEnd(Probe(), boot_id=1, handle=self.handle)
        self.envelope = SafetyEnvelope(delay_ns=2 * delay_ms * MS)
        self.robot = RobotEnd(Probe(), robot_side(self.envelope, boot_id=2))
        self.service = RobotCommands(self.robot.side, boot_id=2, tasks=False, now_ns=0)
        self.bit, self.ordered = StopBit(), None
        self.down, self.up = deque(), deque()
        self.now_ms = 0

    def press(self):
        """The stop in space, also anew."""
        self.ordered = (self.ordered or 0) + 1

    def release_on_the_ground(self):
        self.envelope.handle_stop_released(self.now_ms * MS)
        self.service.step(self.now_ms * MS)
        self.service.control.set_power(True)

    def run(self, ms):
        """Return how far the tip goes (m)."""
        way_m, robot = 0.0, self.robot.side.robot
        for _ in range(ms):
            now_ns, before_m = self.now_ms * MS, robot.x_m
            if self.now_ms % 10 == 0:
                stopped = self.handle.robot_stopped
                self.handle.stop = self.bit.handle_order(self.ordered, stopped, now_ns)
            for end, came, goes in (
                (self.joystick, self.up, self.down),
                (self.robot, self.down, self.up),
            ):
                while came and came[0][0] <= self.now_ms:
                    end.handle_datagram(came.popleft()[1], now_ns)
                if end is self.robot:
                    self.service.step(now_ns)
                end.handle_cycle(now_ns, MS)
                data = end.poll_transmit(now_ns)
                if data is not None and self.random.random() >= self.loss:
                    goes.append((self.now_ms + self.delay_ms, data))
            self.now_ms += 1
            way_m += abs(robot.x_m - before_m)
        return way_m


@pytest.mark.rule("S6")
@pytest.mark.parametrize("delay_ms", [1, 150, 900])
@pytest.mark.parametrize("number", range(repeats(2)))
def test_each_press_of_stop_in_space_stops_whatever_was_released_on_the_ground(delay_ms, number):
    random = Random(first_seed(7) + number)
    both = TwoMachines(random, delay_ms, loss=random.choice((0.0, 0.1)))
    assert both.run(9_000 + 10 * delay_ms) > 0.01
    for _ in range(3):
        both.press()
        both.run(delay_ms + 700)
        assert both.envelope.stopped
        assert both.run(300) < 1e-4
        for _ in range(random.randrange(3)):
            both.release_on_the_ground()
            # Neither its hand leads it, because space holds its stop, nor is it a new stop.
            assert both.run(random.randrange(50, 500)) < 1e-4


@pytest.mark.rule("S6")
@pytest.mark.parametrize(
    ("authority", "other"),
    [(Authority.PARTNER, Authority.OPERATOR), (Authority.OPERATOR, Authority.PARTNER)],
)
def test_a_stop_of_who_does_not_drive_is_obeyed_once_each_time_it_is_given(authority, other):
    envelope = SafetyEnvelope()
    ownership = ControlAuthority(authority, wanted=authority)
    robot = RobotEnd(Probe(), robot_side(envelope, boot_id=1, ownership=ownership))
    sources = {Authority.OPERATOR: robot.handle_datagram, Authority.PARTNER: robot.handle_partner}

    def send(**changes):
        for number in range(3):
            sources[other](pack_command(number, FREE._replace(**changes)), MS)

    send()
    assert not envelope.stopped
    for _ in range(2):
        send(stop=True)
        assert envelope.stopped
        envelope.handle_stop_released(MS)
        # Released here, and not given anew there.
        send(stop=True)
        assert not envelope.stopped
        send()
    for garbage in (b"", b"\x01" * 11, b"\xff" * 12, b"\x41" * 12):
        sources[other](garbage, MS)
    assert not envelope.stopped

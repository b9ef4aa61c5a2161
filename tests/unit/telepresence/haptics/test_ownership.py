"""Two joysticks, one robot, virtual time: the port has one owner, and changes hands at rest."""

from math import hypot

import pytest
from haptic_pair import MS

from telepresence.haptics.bilateral import JoystickSide, RobotSide
from telepresence.haptics.envelope import SafetyEnvelope
from telepresence.haptics.loop import joystick_link, robot_link
from telepresence.haptics.ownership import REST_NS, HapticOwnership, Owner, PartnerBoard
from telepresence.haptics.sample import (
    Command,
    Feedback,
    Greeting,
    pack_command,
    pack_feedback,
    pack_greeting,
)

OURS = pack_command(1, Command(0.0, 0.0, 0))
THEIRS = pack_feedback(1, Feedback(0.0, 0.0, 0, False))


class Bench:
    """The robot, the joystick in space, and the partner's, which holds its button at first."""

    def __init__(self, ownership=None):
        self.ownership = ownership or HapticOwnership()
        self.envelope = SafetyEnvelope()
        self.robot = RobotSide(
            link=robot_link(life=3), ownership=self.ownership, envelope=self.envelope
        )
        self.ends = {
            owner: JoystickSide(link=joystick_link(life=life))
            for life, owner in enumerate(Owner, 1)
        }
        self.now_ns = 0

    def run(self, milliseconds):
        """Return how far the reference is led meanwhile, in m."""
        controller, way_m = self.robot.controller, 0.0
        for _ in range(milliseconds):
            x_m, y_m = controller.reference_x_m, controller.reference_y_m
            self.step()
            if not controller.holding:
                way_m += hypot(controller.reference_x_m - x_m, controller.reference_y_m - y_m)
        return way_m

    def step(self):
        robot, now_ns = self.robot, self.now_ns
        for owner, end in self.ends.items():
            # The joystick in space is let go once at first.
            if owner is Owner.ISS and now_ns < 1000 * MS:
                end.handle.dead_man = now_ns > 200 * MS
            end.handle_cycle(now_ns, MS)
            sample = end.poll_transmit(now_ns)
            if sample is not None and self.ownership.takes(owner):
                robot.handle_datagram(sample, now_ns)
        robot.handle_cycle(now_ns, MS)
        sample = robot.poll_transmit(now_ns)
        if sample is not None and self.ownership.owner is not None:
            self.ends[self.ownership.owner].handle_datagram(sample, now_ns)
        self.now_ns += MS

    def order(self, owner):
        self.ownership.handle_order(owner, self.now_ns)

    def press(self, owner):
        """Let the button go, and press it."""
        for pressed in (False, True):
            self.ends[owner].handle.dead_man = pressed
            self.run(30)


@pytest.fixture
def bench():
    bench = Bench()
    bench.run(1000)
    return bench


@pytest.mark.rule("S3")
def test_a_hand_over_rests_and_then_waits_for_a_new_press_there_and_back(bench):
    assert bench.run(1000) > 0.01
    for owner in (Owner.PARTNER, Owner.ISS):
        bench.order(owner)
        assert bench.ownership.owner is None
        # What was under way is used for 20 ms.
        bench.run(25)
        assert bench.run(REST_NS // MS) == 0.0
        # The new owner has held the button all the time.
        assert bench.run(1500) == 0.0
        assert bench.ownership.report().owner is owner and bench.envelope.waiting
        bench.press(owner)
        assert bench.run(2000) > 0.01 and not bench.envelope.waiting
        assert bench.ends[owner].link.latest(bench.now_ns) is not None
    assert bench.ownership.report().turns == 2
    assert bench.robot.report().least_uj >= -1


def test_only_the_owner_is_heard_and_answered(bench):
    partner, iss = (bench.ends[owner].link for owner in (Owner.PARTNER, Owner.ISS))
    assert bench.ownership.report().refused == {"partner": 1000, "iss": 0}
    assert partner.received == partner.greetings == 0 and iss.received > 900


@pytest.mark.rule("S3")
def test_an_order_taken_back_in_the_middle_needs_a_released_button_too(bench):
    bench.order(Owner.PARTNER)
    bench.run(50)
    bench.order(Owner.ISS)
    bench.run(1000)
    figures = bench.ownership.report()
    assert figures.owner is Owner.ISS and bench.envelope.waiting
    assert figures.refused["partner"] > 1000


@pytest.mark.parametrize("wanted", list(Owner))
def test_a_robot_that_was_started_again_begins_with_nobody(wanted):
    bench = Bench(HapticOwnership(None, wanted=wanted))
    bench.run(1000)
    assert bench.ownership.report().owner is wanted and bench.envelope.waiting


def test_an_order_that_is_given_again_changes_nothing_and_rest_is_needed():
    ownership = HapticOwnership()
    ownership.handle_order(Owner.ISS, 0)
    assert ownership.owner is Owner.ISS and ownership.report().events == ()
    ownership.handle_order(Owner.PARTNER, 0)
    for ms in range(1000):
        assert not ownership.handle_robot(0.0051, ms * MS)
    # At rest from the last motion on, at 999 ms.
    found = [ms for ms in range(1000, 1700) if ownership.handle_robot(0.005, ms * MS)]
    assert found == [1299]
    figures = ownership.report()
    assert (figures.owner, figures.turns) == (Owner.PARTNER, 1)
    assert [event.what for event in figures.events] == ["handing over to partner", "partner drives"]
    # While nobody drives, an order changes who will, and rest goes on.
    ownership.handle_order(Owner.ISS, 2000 * MS)
    for ms in range(2000, 2200):
        ownership.handle_robot(0.0, ms * MS)
    ownership.handle_order(Owner.PARTNER, 2200 * MS)
    found = [ms for ms in range(2200, 2500) if ownership.handle_robot(0.0, ms * MS)]
    assert found == [2300] and ownership.owner is Owner.PARTNER


def rest(board, now_ns):
    """The robot at hand rests for as long as a handover takes."""
    for ms in range(301):
        board.ownership.handle_robot(0.0, now_ns + ms * MS)
    return now_ns + 301 * MS


def test_a_joystick_drives_one_of_two_robots():
    board = PartnerBoard(HapticOwnership())
    asks = [pack_greeting(Greeting(0, 9, 0, who), feedback=False, holding=True) for who in (0, 1)]
    assert (board.left_out, board.state(0), board.is_there(0)) == (False, "absent", False)
    assert board.handle_joystick(OURS, 0) and board.handle_joystick(asks[0], 0)
    board.handle_partner(THEIRS, 0)
    # It is there, and neither of the two hears of the other.
    assert [board.state(ms * MS) for ms in (0, 500, 501)] == ["ready", "ready", "absent"]
    assert board.poll_joystick() is None and board.poll_partner(stopped=False) is None
    # The first request for the other ends what was; the samples of neither are taken meanwhile.
    assert not board.handle_joystick(asks[1], MS) and board.left_out
    assert not board.handle_joystick(OURS, MS) and board.poll_partner(stopped=False) is None
    assert board.ownership.report().refused == {"iss": 2, "partner": 0}
    now_ns = rest(board, MS)
    assert board.left_out and board.ownership.owner is Owner.PARTNER
    for data in (asks[1], OURS):
        assert not board.handle_joystick(data, now_ns)
    # The newest alone goes on, and once; an emergency stop holds it back.
    assert board.poll_partner(stopped=False) == OURS and board.poll_partner(stopped=False) is None
    board.handle_joystick(OURS, now_ns)
    assert board.poll_partner(stopped=True) is None and board.poll_partner(stopped=False) is None
    board.handle_partner(THEIRS, now_ns)
    assert board.state(now_ns) == "driven"
    assert board.poll_joystick() == THEIRS and board.poll_joystick() is None
    # A malformed greeting is ignored; the caller counts it.
    garbled = bytes([1]) + asks[0][1:]
    assert board.handle_joystick(garbled, now_ns) is False
    assert board.ownership.wanted is Owner.PARTNER
    assert not board.handle_joystick(asks[0], now_ns) and board.left_out
    rest(board, now_ns)
    assert not board.left_out and board.handle_joystick(garbled, now_ns)


@pytest.mark.rule("7")
@pytest.mark.parametrize("data", [b"", bytes(11), bytes(13), OURS])
def test_a_partner_that_sends_garbage_is_not_there(data):
    board = PartnerBoard(HapticOwnership(Owner.PARTNER))
    board.handle_partner(data, 0)
    assert (board.ownership.garbage, board.is_there(0)) == (1, False)
    assert board.poll_joystick() is None

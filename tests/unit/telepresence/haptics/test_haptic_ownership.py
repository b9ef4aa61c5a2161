"""Two joysticks, one robot, virtual time: the port has one owner, and changes hands at rest."""

from math import hypot

import pytest
from haptic_pair import MS

from telepresence.haptics.bilateral import JoystickSide, RobotSide
from telepresence.haptics.envelope import SafetyEnvelope
from telepresence.haptics.loop import joystick_link, robot_link
from telepresence.haptics.ownership import REST_NS, HapticOwnership, Owner


class Bench:
    """The robot, the joystick in space, and the partner's."""

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
        for _ in range(milliseconds):
            self.step()
        return self

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

    def moved(self, milliseconds):
        """Return how far the reference is led meanwhile, in m."""
        controller, way_m = self.robot.controller, 0.0
        for _ in range(milliseconds):
            x_m, y_m = controller.reference_x_m, controller.reference_y_m
            self.step()
            if not controller.holding:
                way_m += hypot(controller.reference_x_m - x_m, controller.reference_y_m - y_m)
        return way_m


def test_a_hand_over_rests_then_waits_for_a_released_dead_man_button():
    bench = Bench().run(1000)
    assert bench.moved(1000) > 0.01
    bench.ownership.handle_order(Owner.PARTNER, bench.now_ns)
    assert bench.ownership.owner is None
    # What was under way is used for 20 ms.
    bench.run(25)
    assert bench.moved(REST_NS // MS) == 0.0
    bench.run(1500)
    figures = bench.ownership.report()
    assert figures.owner is Owner.PARTNER and bench.envelope.waiting
    # The partner has held the button all the time.
    assert bench.moved(1000) == 0.0
    handle = bench.ends[Owner.PARTNER].handle
    handle.dead_man = False
    bench.run(20)
    handle.dead_man = True
    assert bench.moved(2000) > 0.01
    assert not bench.envelope.waiting


def test_only_the_owner_is_heard_and_answered():
    bench = Bench().run(500)
    partner, iss = (bench.ends[owner].link for owner in (Owner.PARTNER, Owner.ISS))
    refused = bench.ownership.report().refused
    assert refused["partner"] == 500 and refused["iss"] == 0
    assert partner.received == partner.greetings == 0
    assert iss.received > 400


def test_the_port_goes_there_and_back_and_stays_passive():
    bench = Bench().run(1000)
    for owner in (Owner.PARTNER, Owner.ISS, Owner.PARTNER):
        bench.ownership.handle_order(owner, bench.now_ns)
        bench.run(1000)
        handle = bench.ends[owner].handle
        handle.dead_man = False
        bench.run(50)
        handle.dead_man = True
        assert bench.moved(2000) > 0.01
        assert bench.ends[owner].link.latest(bench.now_ns) is not None
    assert bench.ownership.report().turns == 3
    assert bench.robot.report().least_uj >= -1


def test_an_order_taken_back_in_the_middle_needs_a_released_button_too():
    bench = Bench().run(1000)
    bench.ownership.handle_order(Owner.PARTNER, bench.now_ns)
    bench.run(50)
    bench.ownership.handle_order(Owner.ISS, bench.now_ns)
    bench.run(2000)
    figures = bench.ownership.report()
    assert (
        figures.owner is Owner.ISS and bench.envelope.waiting and figures.refused["partner"] > 1000
    )


@pytest.mark.parametrize("wanted", list(Owner))
def test_a_robot_that_was_started_again_begins_with_nobody(wanted):
    bench = Bench(HapticOwnership(None, wanted=wanted)).run(2000)
    figures = bench.ownership.report()
    assert figures.owner is wanted and bench.envelope.waiting

"""Whose datagrams reach the arm: the joystick's in space, or the partner's, never both."""

import pytest

from kontur_av.clock import NS_PER_MS
from pipelines.hand.haptics import RobotEnd, robot_side
from pipelines.session.probe import Probe
from telepresence.haptics.bilateral import JoystickSide
from telepresence.haptics.envelope import SafetyEnvelope
from telepresence.haptics.loop import joystick_link
from telepresence.haptics.ownership import HapticOwnership, Owner


def received(ownership, source):
    """How many of the samples that `source` sends in 50 ms reach the controller."""
    robot = RobotEnd(Probe(), robot_side(SafetyEnvelope(), life=3, ownership=ownership))
    joystick = JoystickSide(link=joystick_link(life=1))
    take = robot.handle_datagram if source is Owner.ISS else robot.handle_partner
    for now_ns in range(0, 50 * NS_PER_MS, NS_PER_MS):
        joystick.handle_cycle(now_ns, NS_PER_MS)
        sample = joystick.poll_transmit(now_ns)
        if sample is not None:
            take(sample, now_ns)
        robot.handle_cycle(now_ns, NS_PER_MS)
    found = robot.side.link.received_figures()
    return found.received + found.greetings


@pytest.mark.parametrize("source", Owner)
@pytest.mark.parametrize("owner", [*Owner, None])
def test_only_the_owners_datagrams_reach_the_arm(owner, source):
    # While nobody drives, the port goes to the other one: this one drives at no time.
    wanted = owner or next(other for other in Owner if other is not source)
    ownership = HapticOwnership(owner, wanted=wanted)
    assert (received(ownership, source) > 0) == (owner is source)
    assert (ownership.report().refused[source.value] > 0) == (owner is not source)


def test_an_arm_without_a_partner_follows_the_joystick_in_space_alone():
    assert received(None, Owner.ISS) > 0
    assert received(None, Owner.PARTNER) == 0

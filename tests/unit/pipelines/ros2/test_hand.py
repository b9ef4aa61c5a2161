"""A ROS 2 node as the hand: button, staleness, one node at a time."""

from math import inf, nan

import pytest

from kontur_av.clock import NS_PER_MS, NS_PER_S
from kontur_av.errors import ProtocolError
from pipelines.ros2.hand import JoyMessage, Ros2Hand
from telepresence.haptics.device.page import CAPABILITIES

A, B = b"a" * 16, b"b" * 16
STEP_NS = 20 * NS_PER_MS


def joy(x=0.0, y=0.0, *, held=True, more=(), buttons=(False,) * 4):
    return JoyMessage((x, y, *more), (*buttons, held))


@pytest.fixture
def hand():
    return Ros2Hand()


def pressed(hand, now_ns=0):
    """Press the button anew; return the time."""
    for held in (False, True):
        hand.handle_joy(joy(held=held), A, now_ns)
        told = hand.poll_transmit(now_ns)
        now_ns += STEP_NS
    assert told.dead_man
    return now_ns


def test_the_first_axis_is_to_the_left_and_buttons_are_bits():
    hand = Ros2Hand(("z", "roll"))
    hand.handle_joy(joy(0.5, 0.25, held=False), A, 0)
    hand.handle_joy(joy(0.5, 0.25, more=(0.1,), buttons=(True, False, False, True)), A, 1)
    told = hand.poll_transmit(2)
    assert told == (True, -0.5, 0.25, 0b1001, 1, 1, -1, (0.1, 0.0), 0)
    assert hand.poll_transmit(3) is None


@pytest.mark.rule("10")
def test_a_button_that_was_held_before_is_no_press(hand):
    hand.handle_joy(joy(0.5), A, 0)
    assert not hand.poll_transmit(0).dead_man
    now_ns = pressed(hand, STEP_NS)
    # Silent for longer than an input counts.
    now_ns += 200 * NS_PER_MS
    assert hand.poll_transmit(now_ns) is None
    hand.handle_joy(joy(0.5), A, now_ns)
    assert not hand.poll_transmit(now_ns).dead_man
    assert pressed(hand, now_ns + STEP_NS)


def test_one_node_is_heard_until_it_is_silent(hand):
    now_ns = pressed(hand)
    hand.handle_joy(joy(0.9, held=False), B, now_ns)
    assert hand.refused == 1 and hand.poll_transmit(now_ns) is None
    now_ns += 150 * NS_PER_MS
    hand.handle_joy(joy(0.9), B, now_ns)
    told = hand.poll_transmit(now_ns)
    assert not told.dead_man and told.x == -0.9


def test_a_velocity_moves_while_the_button_is_held_and_no_longer(hand):
    hand.handle_velocity({"x": 0.1}, B, 0)
    hand.handle_joy(joy(held=False), A, 0)
    assert hand.poll_transmit(0).x == 0.0
    now_ns = STEP_NS
    for _ in range(10):
        hand.handle_joy(joy(), A, now_ns)
        hand.handle_velocity({"x": 0.1, "y": -0.05}, B, now_ns)
        told = hand.poll_transmit(now_ns)
        now_ns += STEP_NS
    moved = 0.1 * 10 * STEP_NS / NS_PER_S / CAPABILITIES.half_width_m
    assert told.x == pytest.approx(moved) and told.y < 0
    # The velocity is stale, the button is held: it stays.
    now_ns += 300 * NS_PER_MS
    for _ in range(2):
        hand.handle_joy(joy(held=False), A, now_ns)
        told = hand.poll_transmit(now_ns)
        now_ns += STEP_NS
    assert (told.x, told.dead_man) == (0.0, False)


def test_axes_that_cannot_be_are_refused_and_a_velocity_ends_at_the_edge(hand):
    now_ns = pressed(hand)
    for axes in ((), (0.1,), (1.5, 0.0), (nan, 0.0), (0.0, 0.0, inf)):
        with pytest.raises(ProtocolError):
            hand.handle_joy(JoyMessage(axes, (True,) * 5), A, now_ns)
    with pytest.raises(ProtocolError):
        hand.handle_velocity({"x": nan}, A, now_ns)
    assert hand.poll_transmit(now_ns) is None

    # A velocity ends at the edge.
    for _ in range(100):
        hand.handle_joy(joy(0.5), A, now_ns)
        hand.handle_velocity({"x": 1e300}, B, now_ns)
        told = hand.poll_transmit(now_ns)
        now_ns += STEP_NS
    assert told.x == 1.0

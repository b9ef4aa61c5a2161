"""The simulated hand: its movement, its muscles, and its thumb on the dead-man button."""

from itertools import pairwise
from math import hypot

import pytest

from telepresence.haptics.hand import FIRM_GRIP, PUSH, SOFT_GRIP, TAP_TARGETS, Grip, Hand, Waypoint

MS = 1_000_000


def steps(script):
    """Return a hand, and its intended place and velocity in each millisecond of 2 s."""
    hand, seen = Hand(FIRM_GRIP, script=script), []
    for _ in range(2000):
        hand.force(0.0, 0.0, 0.0, 0.0, MS)
        seen.append((hand.x_m, hand.y_m, hand.vx_m_s, hand.vy_m_s))
    return hand, seen


def test_a_movement_goes_straight_to_its_waypoint_with_the_least_jerk():
    """Flash and Hogan 1985: smooth, symmetrical, at most at 1.875 times the mean speed."""
    script = (Waypoint(0.02, 0.05, 400 * MS, 100 * MS), Waypoint(0.06, -0.03, 400 * MS, 0))
    hand, seen = steps(script)
    assert hand.period_ns == 900 * MS and seen[899] == (0.06, -0.03, 0.0, 0.0)
    assert seen[399] == seen[498] == seen[499] == (0.02, 0.05, 0.0, 0.0)
    assert seen[199] == pytest.approx((0.04, 0.01, -0.1875, 0.375))
    assert seen[699] == pytest.approx((0.04, 0.01, 0.1875, -0.375))
    assert seen[900:1800] == [pytest.approx(each) for each in seen[:900]]
    for early, late in zip(seen[:399], seen[398::-1], strict=False):
        assert early[0] - 0.06 == pytest.approx(0.02 - late[0], abs=1e-12)
    for (x, y, *_), (later_x, later_y, vx, vy) in pairwise(seen[:399]):
        assert (later_y - y) == pytest.approx(-2.0 * (later_x - x), abs=1e-9)
        assert hypot(vx, vy) <= hypot(0.1875, 0.375) + 1e-9
        # The velocity is that of the place.
        assert (later_x - x) * 1000 == pytest.approx(vx, abs=2e-3)
    speeds = [vx for _, _, vx, _ in seen[:399]]
    accelerations = [b - a for a, b in pairwise(speeds)]
    assert max(abs(b - a) for a, b in pairwise(accelerations)) < 1e-4


@pytest.mark.parametrize("script", [(), (Waypoint(0.0, 0.0, 0, 0),)])
def test_a_script_takes_some_time(script):
    with pytest.raises(ValueError, match="takes some time"):
        Hand(script=script)
    assert Hand(script=(Waypoint(0.0, 0.0, 0, 1),)).period_ns == 1


def test_the_default_script_touches_a_target_every_two_seconds():
    script_ns = sum(point.move_ns + point.stay_ns for point in TAP_TARGETS)
    assert abs(script_ns - 8_000 * MS) < 50 * MS
    assert sum(point.x_m > 0.06 for point in TAP_TARGETS) == 4


@pytest.mark.parametrize("model", [SOFT_GRIP, FIRM_GRIP, PUSH])
def test_the_muscles_are_a_spring_and_a_damper_with_a_greatest_push(model):
    hand = Hand(model, script=(Waypoint(0.03, 0.04, 0, 1000 * MS),))
    for share in (0.01, 1.0):
        fx, fy = hand.force(0.03 - share * 0.03, 0.04 - share * 0.04, 0.1, -0.2, MS)
        pull_n = min(model.stiffness_n_m * share * 0.05, model.push_n)
        damped = -0.1 * model.damping_n_s_m, 0.2 * model.damping_n_s_m
        assert (fx, fy) == pytest.approx((0.6 * pull_n + damped[0], 0.8 * pull_n + damped[1]))
    assert hand.mass_kg == model.mass_kg and Hand().model is SOFT_GRIP


def test_a_person_lets_go_when_the_robot_is_lost_and_presses_when_it_waits():
    grip, seen = Grip(), []

    def publish(until_ms, *, heard, waiting=False):
        for ms in range(publish.now, until_ms):
            grip.handle_robot(heard, waiting, ms * MS)
            if not seen or seen[-1][1:] != (grip.pressed, grip.following):
                seen.append((ms, grip.pressed, grip.following))
        publish.now = until_ms

    publish.now = 0
    publish(1000, heard=True)
    # Lost after 0.3 s; heard again, but only just let go: presses 0.5 s after that.
    publish(1400, heard=False)
    publish(2000, heard=True, waiting=True)
    publish(2100, heard=True)
    publish(3000, heard=True, waiting=True)
    # A robot that does not follow for 3 s is pressed for anew.
    publish(7000, heard=True, waiting=True)
    publish(7100, heard=True)
    assert seen == [
        (0, True, True),
        (1299, False, False),
        (1799, True, False),
        (2000, True, True),
        (2100, False, False),
        (2600, True, False),
        (5601, False, False),
        (6101, True, False),
        (7000, True, True),
    ]


def test_a_hand_waits_where_the_robot_followed_last_and_goes_on_from_there():
    hand = Hand(script=TAP_TARGETS)

    def run(ms, *, heard=True, waiting=False, at=(0.01, 0.02)):
        for _ in range(ms):
            hand.handle_robot(heard, waiting, *at)
            hand.force(*at, 0.0, 0.0, MS)

    run(100, at=(0.03, -0.01))
    assert hand.dead_man
    # The robot waits: the hand lets go at the handle, and moves to the place of before.
    run(1, waiting=True, at=(0.05, 0.03))
    assert not hand.dead_man
    assert (hand.x_m, hand.y_m) == pytest.approx((0.05, 0.03), abs=1e-5)
    run(249, waiting=True, at=(0.05, 0.03))
    assert (hand.x_m, hand.y_m) == pytest.approx((0.04, 0.01), abs=3e-4)
    run(260, waiting=True, at=(0.05, 0.03))
    assert (hand.x_m, hand.y_m) == (0.03, -0.01) and hand.dead_man
    # What it sees in the picture is where it waits then.
    hand.see(0.0, 0.04)
    run(20, waiting=True)
    assert (hand.x_m, hand.y_m) == (0.0, 0.04)
    run(1)
    assert hand.grip.following
    hand.see(0.1, 0.1)
    # The movement to the present waypoint begins anew there.
    assert (hand.x_m, hand.y_m) == pytest.approx((0.0, 0.04), abs=1e-5)
    run(174)
    goal = TAP_TARGETS[0]
    assert (hand.x_m, hand.y_m) == pytest.approx(
        ((0.0 + goal.x_m) / 2, (0.04 + goal.y_m) / 2), abs=5e-4
    )
    hand.let_go(0.02, 0.0)
    assert not hand.dead_man
    hand.force(0.02, 0.0, 0.0, 0.0, MS)
    assert (hand.x_m, hand.y_m) == pytest.approx((0.02, 0.0), abs=1e-4)

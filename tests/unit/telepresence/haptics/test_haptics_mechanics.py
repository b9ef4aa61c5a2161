"""The simulated joystick, robot, board and hand: each law of motion by itself."""

from dataclasses import replace
from itertools import pairwise
from math import atan2, cos, hypot, pi, sin, tau

import pytest

from telepresence.haptics.board import (
    LEDS_M,
    LIGHTS_M,
    Board,
    ContourModel,
    SpringModel,
    WallModel,
    contour_point,
    led_at,
)
from telepresence.haptics.hand import FIRM_GRIP, PUSH, SOFT_GRIP, TAP_TARGETS, Grip, Hand, Waypoint
from telepresence.haptics.joystick import Joystick, JoystickModel
from telepresence.haptics.robot import Robot
from telepresence.haptics.sample import MODE_IMPEDANCE, MODE_OFF, MODE_POSITION, MODE_TORQUE

MS = 1_000_000
MODEL = JoystickModel()
FREE = Board(spring=None, contour=None)


def state(body):
    return body.x_m, body.y_m, body.vx_m_s, body.vy_m_s


@pytest.mark.parametrize(("hand_kg", "virtual_kg"), [(0.0, 0.0), (0.3, 0.0), (0.2, 0.1)])
def test_a_handle_is_a_mass_with_friction(hand_kg, virtual_kg):
    joystick = Joystick(x_m=0.01, y_m=-0.02)
    joystick.vx_m_s, joystick.vy_m_s, joystick.virtual_kg = 0.3, -0.4, virtual_kg
    joystick.push(1.0, -2.0, 3.0, 0.5, hand_kg, MS)
    # 1 N s/m and 0.2 N against the motion of 0.5 m/s, softened below 5 mm/s.
    drag = 1.0 + 0.2 / 0.505
    vx = 0.3 + (4.0 - drag * 0.3) / (0.4 + hand_kg + virtual_kg) * 1e-3
    vy = -0.4 + (-1.5 + drag * 0.4) / (0.4 + hand_kg + virtual_kg) * 1e-3
    assert state(joystick) == pytest.approx((0.01 + vx * 1e-3, -0.02 + vy * 1e-3, vx, vy))
    assert joystick.work_j == pytest.approx((1.0 * vx - 2.0 * vy) * 1e-3)
    assert (joystick.motor_x_n, joystick.motor_y_n) == (1.0, -2.0)


def test_motors_are_limited_together_and_lose_strength_by_heat():
    joystick = Joystick()
    joystick.push(30.0, -40.0, 0.0, 0.0, 0.0, MS)
    assert (joystick.motor_x_n, joystick.motor_y_n) == pytest.approx((7.2, -9.6))
    # 0.5 K for each N² with a time constant of 240 s, of the force that they have.
    assert joystick.temperature_c == pytest.approx(23.0 + 0.5 * 144.0 * 1e-3 / 240.0)
    for warm_c, limit_n in ((60.0, 12.0), (70.0, 7.5), (80.0, 3.0), (95.0, 3.0), (65.0, 9.75)):
        joystick.temperature_c = warm_c
        joystick.push(0.0, 12.0, 0.0, 0.0, 0.0, MS)
        assert joystick.force_limit_n == pytest.approx(limit_n, rel=1e-3)
    joystick.temperature_c = 40.0
    joystick.push(0.0, 0.0, 0.0, 0.0, 0.0, MS)
    assert joystick.force_limit_n == 12.0 and joystick.temperature_c < 40.0


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("axis", [0, 1])
def test_a_stop_pushes_back_and_never_pulls(axis, sign):
    model = replace(MODEL, viscous_n_s_m=0.0, coulomb_n=0.0)
    end = (model.half_width_m, model.half_height_m)[axis]
    # 5000 N/m and 40 N s/m: 5 N of the depth, ∓4 N of the speed; then too fast to be followed.
    for depth_m, speed_m_s, force_n in ((0.001, 0.1, 9.0), (0.001, -0.1, 1.0), (0.001, -0.5, 0.0)):
        joystick = Joystick(model)
        if axis == 0:
            joystick.x_m, joystick.vx_m_s = sign * (end + depth_m), sign * speed_m_s
        else:
            joystick.y_m, joystick.vy_m_s = sign * (end + depth_m), sign * speed_m_s
        joystick.push(0.0, 0.0, 0.0, 0.0, 0.0, MS)
        got = (joystick.vx_m_s, joystick.vy_m_s)
        assert got[axis] == pytest.approx(sign * (speed_m_s - force_n / 0.4 * 1e-3))
        assert got[1 - axis] == 0.0
    free = Joystick(model, x_m=end if axis == 0 else 0.0, y_m=end if axis else 0.0)
    free.push(0.0, 0.0, 0.0, 0.0, 0.0, MS)
    assert state(free)[2:] == (0.0, 0.0)


def test_the_tip_is_a_mass_with_friction_and_each_joint_has_its_limit():
    robot = Robot(board=FREE, x_m=0.01, y_m=0.02)
    robot.vx_m_s, robot.vy_m_s = 0.1, -0.2
    robot.step(3.0, -2.0, MS)
    vx, vy = 0.1 + (3.0 - 0.05) * 2e-3, -0.2 + (-2.0 + 0.1) * 2e-3
    assert state(robot) == pytest.approx((0.01 + vx * 1e-3, 0.02 + vy * 1e-3, vx, vy))
    assert robot.work_j == pytest.approx((3.0 * vx - 2.0 * vy) * 1e-3)
    joints = robot.joints
    assert [joint.torque_n_m for joint in joints] == pytest.approx([1.2, -0.8])
    assert [joint.angle_rad for joint in joints] == pytest.approx(
        [robot.x_m / 0.4, robot.y_m / 0.4]
    )
    for force, got in (((31.0, 3.0), (30.0, 3.0)), ((3.0, -31.0), (3.0, -30.0))):
        robot.step(*force, MS)
        assert [joint.torque_n_m / 0.4 for joint in robot.joints] == pytest.approx(list(got))
    robot.step(-31.0, 31.0, MS)
    assert [joint.torque_n_m / 0.4 for joint in robot.joints] == pytest.approx([-30.0, 30.0])
    with pytest.raises(ValueError, match="at most 1000000 ns"):
        robot.step(0.0, 0.0, MS + 1)


def driven(robot, ms):
    places = []
    for _ in range(ms):
        robot.drive(MS)
        places.append((robot.x_m, robot.y_m))
    return places


def test_each_mode_drives_the_tip_in_its_own_way():
    robot = Robot(board=FREE, x_m=0.0, y_m=0.03)
    assert (robot.mode, robot.coupled) == (MODE_IMPEDANCE, True)
    robot.set_torque(0.4, -0.8)
    robot.drive(MS)
    assert (robot.mode, robot.coupled) == (MODE_TORQUE, False)
    assert state(robot)[2:] == pytest.approx((1.0 * 2e-3, -2.0 * 2e-3))
    robot.set_off()
    assert (robot.mode, robot.coupled) == (MODE_OFF, False)
    driven(robot, 30)
    assert hypot(*state(robot)[2:]) < 1e-6
    begin = robot.x_m, robot.y_m
    robot.set_position(begin[0] + 0.03, begin[1] - 0.015)
    places = driven(robot, 400)
    assert robot.mode == MODE_POSITION and not robot.coupled
    # 0.3 m/s along each axis; a damper of 90 N s/m leaves the tip behind by 6.75 mm.
    assert places[99][0] == pytest.approx(begin[0] + 0.03 - 0.00675, abs=3e-4)
    assert places[49][1] == pytest.approx(begin[1] - 0.015 + 0.00675, abs=1e-3)
    assert places[-1] == pytest.approx((begin[0] + 0.03, begin[1] - 0.015), abs=1e-5)
    # A new goal is reached from the setpoint, not from the tip.
    robot.set_position(begin[0], begin[1])
    robot.x_m += 0.001
    robot.drive(MS)
    # 4000 N/m and 90 N s/m, at a mass of 0.5 kg.
    pull_n = 4000.0 * (begin[0] + 0.03 - 0.0003 - (places[-1][0] + 0.001))
    assert robot.vx_m_s == pytest.approx(pull_n * 2e-3, rel=1e-2)
    robot.set_impedance(0.01, 0.02, 100.0, 5.0)
    assert (robot.mode, robot.coupled) == (MODE_IMPEDANCE, False)
    x, y, vx, vy = state(robot)
    robot.drive(MS)
    assert robot.vx_m_s == pytest.approx(vx + (100.0 * (0.01 - x) - 5.5 * vx) * 2e-3)
    assert robot.vy_m_s == pytest.approx(vy + (100.0 * (0.02 - y) - 5.5 * vy) * 2e-3)
    robot.couple()
    assert (robot.mode, robot.coupled) == (MODE_IMPEDANCE, True)


def test_a_robot_lights_what_it_touches():
    robot = Robot(x_m=0.0598, y_m=0.05)
    assert robot.led() is None and not robot.contact
    robot.x_m = 0.061
    robot.step(0.0, 0.0, MS)
    assert robot.contact and robot.led() == 2
    assert (robot.force_n, robot.push_x_n) == (pytest.approx(1.5), pytest.approx(-1.5))


@pytest.mark.parametrize("index", range(len(LEDS_M)))
def test_a_contact_within_12_mm_of_a_target_lights_it(index):
    x, y = LEDS_M[index]
    assert led_at(x, y) == led_at(x - 0.0119, y) == led_at(x, y + 0.0119) == index
    assert led_at(x + 0.0085, y - 0.0085) is None and led_at(x + 0.0084, y + 0.0084) == index


def test_seven_lights_surround_the_eighth():
    middle, around = LIGHTS_M[0], LIGHTS_M[1:]
    assert len(around) == 7 and middle == (-0.045, 0.0)
    angles = sorted(atan2(y, x + 0.045) % tau for x, y in around)
    assert all(hypot(x + 0.045, y) == pytest.approx(0.042) for x, y in around)
    assert [b - a for a, b in pairwise(angles)] == pytest.approx([tau / 7] * 6)
    assert any(angle == pytest.approx(pi) for angle in angles)


def test_a_wall_is_a_spring_and_a_damper_that_never_pulls_and_rubs():
    board = Board()
    assert board.press(0.06, 0.0, 1.0, 0.0) == (0.0, 0.0) and not board.touching
    push, rub = board.press(0.062, 0.0, 0.05, 0.03)
    assert push == pytest.approx(-(3.0 + 1.0)) and rub == pytest.approx(-0.15 * 4.0 * 0.03 / 0.04)
    assert board.wall_n == pytest.approx(4.0) and board.touching
    assert board.press(0.062, 0.0, 0.0, -0.03)[1] == pytest.approx(0.15 * 3.0 * 0.75)
    assert board.press(0.062, 0.0, -1.0, 0.1) == (0.0, 0.0) and board.touching
    assert board.press(0.05, 0.0, 0.0, 0.0) == (0.0, 0.0)
    assert board.wall_n == 0.0 and not board.touching
    for stiffness in (0.0, 5000.0):
        assert WallModel(stiffness_n_m=stiffness).stiffness_n_m == stiffness
    for stiffness in (-1.0, 5001.0):
        with pytest.raises(ValueError, match="a wall has 0 to 5000 N/m"):
            WallModel(stiffness_n_m=stiffness)


def test_the_spring_is_at_the_left_edge_only():
    board = Board(contour=None)
    assert board.press(-0.125, 0.019, 0.5, 0.5) == (pytest.approx(2.0), 0.0) and board.touching
    for x, y in ((-0.125, 0.021), (-0.125, -0.021), (-0.114, 0.0)):
        assert board.press(x, y, 0.0, 0.0) == (0.0, 0.0) and not board.touching
    assert Board(spring=None, contour=None).press(-0.125, 0.0, 0.0, 0.0) == (0.0, 0.0)


@pytest.mark.parametrize("degrees", range(0, 360, 24))
def test_the_groove_pushes_to_its_middle_and_takes_no_energy(degrees):
    board = Board(spring=None)
    t = degrees * pi / 180.0
    x, y = contour_point(t)
    # The drawn curve, as the world draws it.
    assert (x, y) == pytest.approx(
        (-0.045 + 0.068 * cos(t) - 0.008 * cos(3 * t), 0.07 * sin(t) + 0.006 * sin(3 * t))
    )
    radius, angle = hypot(x + 0.045, y), atan2(y, x + 0.045)

    def force(away_m, turn=0.0):
        out = radius + away_m
        at = -0.045 + out * cos(angle + turn), out * sin(angle + turn)
        fx, fy = board.press(*at, 0.0, 0.0)
        return fx * cos(angle + turn) + fy * sin(angle + turn), fx, fy, at

    # Halfway out: 4 depth/width * a * (1 - a²), with 4 mJ, 8 mm and a = 0.5.
    for away_m, expected_n in ((0.0, 0.0), (0.004, -0.75), (-0.004, 0.75), (0.0085, 0.0)):
        assert force(away_m)[0] == pytest.approx(expected_n, abs=0.02), away_m
    assert force(-0.0085)[1:3] == (0.0, 0.0) and not board.touching
    # Once round a small ring there is no work.
    work_j, last = 0.0, None
    for k in range(241):
        _, fx, fy, at = force(0.003 + 0.002 * cos(tau * k / 240), 0.02 * sin(tau * k / 240))
        if last is not None:
            work_j += (fx + last[0]) / 2 * (at[0] - last[2][0])
            work_j += (fy + last[1]) / 2 * (at[1] - last[2][1])
        last = fx, fy, at
    assert abs(work_j) < 2e-5


def test_no_part_of_the_board_acts_where_there_is_none():
    board = Board(contour=ContourModel(), spring=SpringModel())
    for x, y in ((0.045, 0.0), (0.045, 0.09), (-0.045, 0.005), (0.031, 0.0), (-0.045, 0.0)):
        assert board.press(x, y, 0.3, 0.3) == (0.0, 0.0)


def test_a_movement_of_the_hand_has_the_least_jerk():
    """Flash and Hogan 1985: half the way at half the time, at 1.875 times the mean speed."""
    script = (Waypoint(0.02, 0.05, 400 * MS, 100 * MS), Waypoint(0.06, -0.03, 400 * MS, 0))
    hand = Hand(FIRM_GRIP, script=script)
    assert hand.period_ns == 900 * MS and (hand.x_m, hand.y_m) == (0.06, -0.03)
    seen = {}
    for ms in range(1, 1900):
        hand.force(0.0, 0.0, 0.0, 0.0, MS)
        seen[ms] = (hand.x_m, hand.y_m, hand.vx_m_s, hand.vy_m_s)
    assert seen[200] == pytest.approx((0.04, 0.01, -0.1875, 0.375))
    assert seen[100][:2] == pytest.approx((0.06 - 0.04 * 0.103515625, -0.03 + 0.08 * 0.103515625))
    assert seen[100][2] == pytest.approx(-0.1 * 30 / 16 * 9 / 16)
    assert seen[400] == seen[499] == seen[500] == (0.02, 0.05, 0.0, 0.0)
    assert seen[700] == pytest.approx((0.04, 0.01, 0.1875, -0.375))
    assert seen[1100] == pytest.approx(seen[200])
    for script in ((), (Waypoint(0.0, 0.0, 0, 0),)):
        with pytest.raises(ValueError, match="takes some time"):
            Hand(script=script)
    assert Hand(script=(Waypoint(0.0, 0.0, 0, 1),)).period_ns == 1


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

    def tell(until_ms, *, heard, waiting=False):
        for ms in range(tell.now, until_ms):
            grip.handle_robot(heard, waiting, ms * MS)
            if not seen or seen[-1][1:] != (grip.pressed, grip.following):
                seen.append((ms, grip.pressed, grip.following))
        tell.now = until_ms

    tell.now = 0
    tell(1000, heard=True)
    # Lost after 0.3 s; heard again, but only just let go: presses 0.5 s after that.
    tell(1400, heard=False)
    tell(2000, heard=True, waiting=True)
    tell(2100, heard=True)
    tell(3000, heard=True, waiting=True)
    # A robot that does not follow for 3 s is pressed for anew.
    tell(7000, heard=True, waiting=True)
    tell(7100, heard=True)
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

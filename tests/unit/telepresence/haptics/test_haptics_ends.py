"""The simulated joystick, hand, robot and board, and both controllers, each alone."""

from itertools import pairwise
from math import hypot, pi

import pytest
from haptic_session import begin_session

from telepresence.haptics.bilateral import JoystickSide
from telepresence.haptics.board import Board, WallModel, contour_point, led_at
from telepresence.haptics.hand import FIRM_GRIP, SOFT_GRIP, TAP_TARGETS, Hand, Waypoint
from telepresence.haptics.joystick import Joystick, JoystickModel
from telepresence.haptics.joystick_controller import JoystickController, JoystickControllerModel
from telepresence.haptics.robot import Robot, RobotModel
from telepresence.haptics.robot_controller import RobotController, RobotControllerModel
from telepresence.haptics.sample import (
    STATE_APPLICATION,
    STATE_HALTED,
    Command,
    Feedback,
    pack_feedback,
)
from telepresence.world.board import contour_m

MS = 1_000_000


def test_the_wall_pushes_and_never_pulls() -> None:
    board = Board(WallModel(stiffness_n_m=5000.0))
    assert board.press(0.0599, 0.0, 5.0, 0.0) == (0.0, 0.0)
    assert not board.touching
    push, rub = board.press(0.061, 0.0, 0.0, 0.2)
    assert push == pytest.approx(-5.0)
    assert board.touching
    # Coulomb friction against the motion; at 0.2 m/s it has almost its full value.
    assert -0.15 * 5.0 < rub < -0.9 * 0.15 * 5.0
    assert board.press(0.0601, 0.0, -1.0, 0.0) == (0.0, 0.0)


def test_a_stiffer_wall_is_refused() -> None:
    with pytest.raises(ValueError):
        WallModel(stiffness_n_m=5001.0)


@pytest.mark.parametrize("stiffness_n_m", [100.0, 1500.0, 5000.0])
def test_a_press_on_any_wall_comes_to_rest(stiffness_n_m: float) -> None:
    robot = Robot(board=Board(WallModel(stiffness_n_m=stiffness_n_m)))
    robot.set_impedance(0.08, 0.0, 1000.0, 45.0)
    forces = []
    for _ in range(2000):
        robot.drive(MS)
        forces.append(robot.force_n)
    # Two springs in series.
    due = 0.02 * 1000.0 * stiffness_n_m / (1000.0 + stiffness_n_m)
    assert forces[-1] == pytest.approx(due, rel=1e-3)
    assert max(forces[-200:]) - min(forces[-200:]) < 1e-6
    assert robot.push_x_n == -robot.force_n


def test_the_groove_follows_the_drawn_contour_and_is_lossless() -> None:
    board = Board()
    for x, y in contour_m()[::7]:
        assert board.press(x, y, 0.0, 0.0) == pytest.approx((0.0, 0.0), abs=0.03)
        assert not board.touching
    # Inside and outside the curve, the push points towards it.
    x, y = contour_point(pi / 2)
    assert board.press(x, y + 0.003, 0.0, 0.0)[1] < -0.5
    assert board.press(x, y - 0.003, 0.0, 0.0)[1] > 0.5
    # Once around a loop that crosses the groove: the work in a potential is zero.
    work, step, at = 0.0, 2e-5, (x - 0.01, y - 0.012)
    for dx, dy in ((1, 0), (0, 1), (-1, 0), (0, -1)):
        for _ in range(1000):
            fx, fy = board.press(at[0] + dx * step / 2, at[1] + dy * step / 2, 0.0, 0.0)
            work += (fx * dx + fy * dy) * step
            at = (at[0] + dx * step, at[1] + dy * step)
    assert abs(work) < 0.02 * 0.004


def test_the_plate_springs_back() -> None:
    board = Board()
    assert board.press(-0.125, 0.0, 0.0, 0.0) == pytest.approx((2.0, 0.0))
    assert board.touching
    assert board.press(-0.125, 0.03, 0.0, 0.0) == (0.0, 0.0)
    assert Board(spring=None).press(-0.125, 0.0, 0.0, 0.0) == (0.0, 0.0)


def test_a_target_is_lit_within_its_reach() -> None:
    assert led_at(0.0612, -0.05) == 0
    assert led_at(0.0612, 0.011) == 1
    assert led_at(0.0612, 0.013) is None


def test_torque_mode_gives_the_torque_through_the_lever() -> None:
    robot = Robot(RobotModel(friction_n_s_m=0.0))
    robot.set_torque(0.2, -0.1)
    for _ in range(100):
        robot.drive(MS)
    # 0.2 N m over 0.4 m on 0.5 kg: 1 m/s².
    assert robot.vx_m_s == pytest.approx(0.1)
    assert robot.vy_m_s == pytest.approx(-0.05)
    assert robot.work_j == pytest.approx(0.5 * 0.5 * (0.1**2 + 0.05**2), rel=0.02)


def test_position_mode_moves_at_its_speed_and_stays() -> None:
    robot = Robot()
    robot.set_position(0.03, 0.06)
    steps = []
    for _ in range(2000):
        before = robot.y_m
        robot.drive(MS)
        steps.append(robot.y_m - before)
    assert (robot.x_m, robot.y_m) == pytest.approx((0.03, 0.06), abs=1e-4)
    assert max(steps) < 1.1 * RobotModel().position_m_s * 1e-3


def test_when_off_the_brakes_hold() -> None:
    robot = Robot()
    robot.vx_m_s = 0.3
    robot.set_off()
    for _ in range(100):
        robot.drive(MS)
    assert abs(robot.vx_m_s) < 1e-3
    assert robot.x_m < 0.002
    assert robot.work_j < 0.0


def test_the_hand_follows_its_script_and_repeats_it() -> None:
    joystick = Joystick()
    hand = Hand(
        FIRM_GRIP,
        script=(Waypoint(0.02, 0.03, 200 * MS, 300 * MS), Waypoint(-0.04, 0.0, 200 * MS, 300 * MS)),
    )
    assert hand.period_ns == 1_000 * MS
    for target in ((0.02, 0.03), (-0.04, 0.0)) * 2:
        for _ in range(500):
            pull = hand.force(joystick.x_m, joystick.y_m, joystick.vx_m_s, joystick.vy_m_s, MS)
            joystick.push(0.0, 0.0, *pull, hand.mass_kg, MS)
        assert (joystick.x_m, joystick.y_m) == pytest.approx(target, abs=1e-3)


def test_a_soft_grip_yields_more_than_a_firm_one() -> None:
    ways = []
    for grip in (SOFT_GRIP, FIRM_GRIP):
        joystick = Joystick()
        hand = Hand(grip, script=(Waypoint(0.0, 0.0, 0, 1_000 * MS),))
        for _ in range(3000):
            pull = hand.force(joystick.x_m, joystick.y_m, joystick.vx_m_s, joystick.vy_m_s, MS)
            joystick.push(-3.0, 0.0, *pull, hand.mass_kg, MS)
        ways.append(-joystick.x_m)
    assert ways == pytest.approx([3.0 / 250.0, 3.0 / 700.0], rel=0.02)


def test_the_default_script_touches_a_target_every_two_seconds() -> None:
    script_ns = sum(point.move_ns + point.stay_ns for point in TAP_TARGETS)
    assert abs(script_ns - 8_000 * MS) < 50 * MS
    assert sum(point.x_m > 0.06 for point in TAP_TARGETS) == 4


def test_the_stops_end_the_workspace() -> None:
    joystick = Joystick()
    for _ in range(2000):
        joystick.push(0.0, 0.0, 20.0, -20.0, 0.2, MS)
    model = JoystickModel()
    assert model.half_width_m < joystick.x_m < model.half_width_m + 0.01
    assert -model.half_height_m - 0.01 < joystick.y_m < -model.half_height_m


def test_hot_motors_exert_less_force_until_they_cool_down() -> None:
    joystick = Joystick(JoystickModel(warm_s=2.0))
    limits = []
    for _ in range(20_000):
        limits.append(joystick.force_limit_n)
        joystick.push(20.0, 0.0, -12.0, 0.0, 0.2, MS)
        assert joystick.motor_x_n == pytest.approx(limits[-1])
    assert limits[0] == 12.0
    assert all(later <= earlier for earlier, later in pairwise(limits))
    # At this temperature heating equals cooling, so derating keeps it below its end.
    assert 60.0 < joystick.temperature_c < 80.0
    assert 3.0 < limits[-1] < 12.0
    for _ in range(10_000):
        joystick.push(0.0, 0.0, 0.0, 0.0, 0.2, MS)
    assert joystick.force_limit_n == 12.0
    assert joystick.temperature_c == pytest.approx(23.0, abs=0.5)


def test_the_displayed_force_is_limited_in_size_and_in_rate_and_decays_in_silence() -> None:
    model, joystick_side = JoystickControllerModel(), JoystickController(passive=False)
    joystick_side.limit_n = 9.0
    push = Feedback(-9.0, 12.0, 0, True)
    assert joystick_side.step(push, 0.0, 0.0, MS) == (0.0, 0.0)
    force = joystick_side.step(push, 0.0, 0.0, MS)
    assert force == pytest.approx((-0.6 * model.rate_n_s / 1000, 0.8 * model.rate_n_s / 1000))
    for _ in range(100):
        force = joystick_side.step(push, 0.0, 0.0, MS)
    assert force == pytest.approx((-5.4, 7.2))
    forces = [joystick_side.step(None, 0.0, 0.0, MS)[1] for _ in range(2000)]
    assert all(later <= earlier + 1e-9 for earlier, later in pairwise(forces))
    assert forces[-1] < 0.01


class Rail:
    """A handle that glides at 0.2 m/s along +x, whatever force acts on it."""

    x_m = y_m = 0.0
    force_limit_n, dead_man, buttons, state = 12.0, True, 0, STATE_APPLICATION
    stop = blind = False

    more = ()

    def __init__(self) -> None:
        self.felt: list[float] = []

    def step(self, fx_n: float, fy_n: float, dt_ns: int) -> None:
        self.felt.append(fx_n)
        self.x_m += 0.2 * dt_ns / 1e9


@pytest.mark.parametrize("advances_ns", [[MS], [1_020_000], [980_000, 1_050_000], [MS, MS, 4 * MS]])
def test_a_late_cycle_causes_no_jerk(advances_ns: list[int]) -> None:
    handle, now_ns = Rail(), 0
    # With a constant damping.
    side = JoystickSide(handle=handle, model=JoystickControllerModel(most_damping_n_s_m=4.0))
    session = begin_session(side.link)
    for k in range(400):
        now_ns += advances_ns[k % len(advances_ns)]
        feedback = pack_feedback(k, Feedback(0.0, 0.0, 0, False), session=session)
        side.handle_datagram(feedback, now_ns)
        side.handle_cycle(now_ns, advances_ns[k % len(advances_ns)])
    assert handle.felt[100:] == pytest.approx([-0.8] * len(handle.felt[100:]), rel=1e-3)


def displayed(fx_n: float, fy_n: float, credit_j: float, v_m_s: float) -> list[float]:
    """Return the size of a force that stays on a handle that moves along +x, cycle by cycle."""
    model = JoystickControllerModel(damping_n_s_m=0.0, most_damping_n_s_m=0.0)
    joystick_side = JoystickController(model)
    joystick_side.step(None, 0.0, 0.0, MS)
    sizes = []
    for k in range(600):
        if k < 300:
            # Enough for any force while the handle rests.
            joystick_side.port.credit_j = 0.5
        elif k == 300:
            joystick_side.port.credit_j = credit_j
        x_m = max(0, k - 299) * v_m_s * 1e-3
        fx, fy = joystick_side.step(Feedback(fx_n, fy_n, 0, True), x_m, 0.0, MS)
        # A bound changes the size of a force, not its direction.
        assert fx * fy_n == pytest.approx(fy * fx_n)
        sizes.append(hypot(fx, fy))
    assert joystick_side.least_observed_uj >= -1.0
    return sizes[299:]


def test_a_force_fades_like_a_spring_whose_energy_is_the_credit() -> None:
    model = JoystickControllerModel()
    # A hand at rest feels what the credit can let fade.
    resting = displayed(-6.0, 0.0, 0.004, 0.0)
    next_cycle_j = resting[-1] * model.acceleration_m_s2 * 1e-6
    fade_j = resting[-1] ** 2 / (2.0 * model.fade_n_m)
    assert next_cycle_j + fade_j == pytest.approx(0.004, rel=1e-3)
    assert displayed(-6.0, 0.0, 0.1, 0.0)[-1] == pytest.approx(6.0)
    # A hand that gives way uses the credit up: the force fades to nothing, and never suddenly.
    for speed_m_s in (0.05, 0.3, 1.0):
        fading = displayed(6.0, 0.0, 0.05, speed_m_s)
        assert fading[0] == pytest.approx(6.0)
        assert fading[-1] < 0.1
        assert max(a - b for a, b in pairwise(fading)) <= model.rate_n_s * 1e-3 + 1e-9
    # A hand that pushes against the force pays for it.
    assert displayed(-6.0, 0.0, 0.004, 0.1)[-1] == pytest.approx(6.0)
    # A force across the motion costs nothing, so it stays.
    assert displayed(0.0, 6.0, 0.05, 0.3)[-1] == pytest.approx(6.0)


def test_the_damping_follows_what_either_end_lacks() -> None:
    model, joystick_side = JoystickControllerModel(), JoystickController()
    joystick_side.step(None, 0.0, 0.0, MS)

    def after(feedback: Feedback | None, credit_j: float, cycles: int) -> float:
        for _ in range(cycles):
            joystick_side.port.credit_j = credit_j
            joystick_side.step(feedback, 0.0, 0.0, MS)
        return joystick_side.damping_n_s_m

    whole, starved = Feedback(0.0, 0.0, 0, False), Feedback(0.0, 0.0, 0, False, acted=True)
    assert after(whole, model.reserve_j, 2000) == pytest.approx(model.damping_n_s_m)
    assert after(whole, 0.0, 2000) == pytest.approx(model.most_damping_n_s_m, rel=0.01)
    assert after(whole, model.reserve_j, 10_000) == pytest.approx(model.damping_n_s_m, rel=0.01)
    assert after(starved, model.reserve_j, 2000) == pytest.approx(
        model.most_damping_n_s_m, rel=0.01
    )
    # Without samples nobody knows what is lacking.
    assert after(None, 0.0, 2000) == pytest.approx(model.damping_n_s_m, rel=0.01)


def test_each_end_returns_what_it_does_not_need_to_an_end_that_lacks() -> None:
    def granted_uj(acted: bool, force_n: float) -> int:
        side = JoystickController()
        side.port.credit_j = side.model.reserve_j
        for _ in range(1000):
            side.step(Feedback(-force_n, 0.0, 0, True, acted=acted), 0.0, 0.0, MS)
        return side.granted_uj

    model = JoystickControllerModel()
    assert granted_uj(False, 0.0) == 0
    assert granted_uj(True, 0.0) == pytest.approx(1e6 * model.reserve_j, rel=0.01)
    needed_uj = 1e6 * 8.0**2 / (2.0 * model.fade_n_m)
    assert granted_uj(True, 8.0) == pytest.approx(1e6 * model.reserve_j - needed_uj, rel=0.02)

    def robot_grants_uj(acted: bool, touching: bool) -> tuple[int, float]:
        side = RobotController()
        side.port.credit_j = 0.1
        for _ in range(3000):
            side.step(Command(0.0, 0.0, 0, acted=acted), 0.0, 0.0, 0.0, 0.0, MS, touching=touching)
        return side.granted_uj, side.port.credit_j

    spare_j = RobotControllerModel().spare_j
    assert robot_grants_uj(False, False) == (0, pytest.approx(0.1))
    assert robot_grants_uj(True, False) == (
        pytest.approx(1e6 * (0.1 - spare_j), rel=0.01),
        pytest.approx(spare_j),
    )
    # In contact what is left over is lost.
    assert robot_grants_uj(False, True) == (0, pytest.approx(spare_j, rel=0.1))


def test_a_hand_that_yields_at_once_receives_no_more_than_the_credit() -> None:
    for credit_j in (0.0, 1e-5, 1e-4, 1e-3):
        joystick_side = JoystickController(JoystickControllerModel(rate_n_s=1e6))
        joystick_side.port.credit_j = credit_j
        x_m = v_m_s = 0.0
        for k in range(100):
            joystick_side.step(Feedback(10.0, 0.0, 0, True), x_m, 0.0, MS)
            # First at rest, then with the greatest acceleration that the controller allows for.
            v_m_s += joystick_side.model.acceleration_m_s2 * 1e-3 if 50 <= k < 60 else 0.0
            x_m += v_m_s * 1e-3
            assert joystick_side.credit_uj >= -1.0


@pytest.mark.parametrize(
    "command",
    [
        None,
        Command(0.1, 0.0, 0, dead_man=False),
        Command(0.1, 0.0, 0, state=STATE_HALTED),
        Command(0.1, 0.0, 0, halted=True),
    ],
)
def test_without_a_valid_command_the_robot_holds_and_its_pressure_decays(
    command: Command | None,
) -> None:
    robot_side, robot = RobotController(x_m=0.085), Robot(x_m=0.061)
    places, forces = [], []
    for _ in range(3000):
        drive = robot_side.step(command, robot.x_m, robot.y_m, robot.vx_m_s, robot.vy_m_s, MS)
        robot.step(*drive, MS)
        places.append(robot.x_m)
        forces.append(robot.force_n)
    assert robot_side.holding
    assert max(forces) > 5.0
    assert forces[-1] < 0.2
    assert 0.059 < min(places[500:]) <= max(places) < 0.08
    assert robot_side.credit_uj >= 0.0


def test_a_blocked_reference_pulls_only_with_its_spring() -> None:
    # The step's part to the left brings energy, and its part upwards costs some. With the force to
    # the left cut to its limit, the first no longer pays for the second, and there is no credit.
    robot_side = RobotController()
    force = robot_side.step(Command(-0.05, 0.1, 0), -0.05, -0.02, 0.0, 0.0, MS)
    assert force == pytest.approx((30.0, 20.0))
    assert (robot_side.reference_x_m, robot_side.reference_y_m) == (0.0, 0.0)
    assert (robot_side.energy_out_uj, robot_side.energy_in_uj) == (0, 0)


def test_a_command_outside_the_board_is_followed_to_its_edge() -> None:
    robot_side, robot = RobotController(), Robot(board=Board(WallModel(stiffness_n_m=0.0)))
    for k in range(4000):
        command = Command(-9.0, 9.0, 20_000 * k)
        drive = robot_side.step(command, robot.x_m, robot.y_m, robot.vx_m_s, robot.vy_m_s, MS)
        robot.step(*drive, MS)
    assert (robot_side.reference_x_m, robot_side.reference_y_m) == pytest.approx(
        (-0.15, 0.10), abs=1e-6
    )

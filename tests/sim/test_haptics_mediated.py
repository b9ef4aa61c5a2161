"""Mediated haptics with long delays: the wall is felt as at no delay, calmly and passively."""

from functools import cache
from math import hypot, sin

import numpy as np
import pytest
from mediated_pair import MediatedPair

from pipelines.session.setup.setup_file import load_setup
from pipelines.virtual.simulate import simulate
from telepresence.haptics.board import WALL_X_M
from telepresence.haptics.envelope import SafetyEnvelope
from telepresence.haptics.hand import FIRM_GRIP, SOFT_GRIP, HandModel, Waypoint
from telepresence.haptics.mediated.controller import MediatedController, RendererModel
from telepresence.haptics.mediated.wall import Wall, WallMessage, pack_wall
from telepresence.haptics.sample import Feedback

MS = 1_000_000
HEAVY_ARM = HandModel(stiffness_n_m=800.0, damping_n_s_m=24.0, mass_kg=2.0)
#: Touches the wall for 2 s, leaves it for 1 s.
PRESS = (
    Waypoint(0.04, 0.0, 300 * MS, 700 * MS),
    Waypoint(0.085, 0.0, 500 * MS, 2500 * MS),
)


def pressed(rows: np.ndarray) -> np.ndarray:
    """Rows of the last second of each press."""
    return rows.reshape(-1, 4000, rows.shape[1])[:, 3000:]


def felt_n_m(rows: np.ndarray) -> np.ndarray:
    """Force over penetration of the handle, at the end of each press."""
    last = pressed(rows)[:, -500:].mean(axis=1)
    return -last[:, 1] / (last[:, 0] - WALL_X_M)


def check_energy(pair: MediatedPair) -> None:
    """The motors gave no more than they had, the robot what the hand put in, not the wall's."""
    gave_j = -np.diff(pair.rows[:, 2])
    assert pair.rows[:, 2].max() <= RendererModel().start_j
    assert pair.space.controller.port.in_j <= gave_j[gave_j > 0.0].sum() + 1e-9
    assert pair.ground.controller.port.least_j > -1e-9


def largest_step_n(rows: np.ndarray) -> float:
    return np.hypot(*np.diff(rows[:, [1, 4]], axis=0).T).max()


@cache
def near_n_m(grip: HandModel) -> float:
    """What this hand feels without a delay."""
    near = MediatedPair(0, grip, mediated=False, script=PRESS)
    near.run(8)
    return felt_n_m(near.rows)[-1]


def test_an_adaptive_hand_is_direct_below_60_ms_and_has_its_walls_beyond():
    free = {"residual": True, "adaptive": True}
    # A hand that moves before it hears the robot is braked.
    script = (Waypoint(0.04, 0.0, MS, 300 * MS), *PRESS[::-1])
    near = MediatedPair(40, SOFT_GRIP, script=script, **free)
    direct = MediatedPair(40, SOFT_GRIP, script=script, mediated=False)
    far = MediatedPair(200, SOFT_GRIP, script=PRESS, **free)
    for pair in (near, direct, far):
        pair.run(8)
    assert np.array_equal(near.rows, direct.rows)
    assert near.ground.estimator.wall is not None and not near.ground.estimator.sent
    assert felt_n_m(far.rows)[-1] == pytest.approx(near_n_m(SOFT_GRIP), rel=0.2)


@pytest.mark.parametrize("grip", [SOFT_GRIP, FIRM_GRIP, HEAVY_ARM], ids=["soft", "firm", "arm"])
@pytest.mark.parametrize("round_trip_ms", [800])
def test_a_wall_is_felt_as_without_delay_and_does_not_swing(grip, round_trip_ms):
    far = MediatedPair(round_trip_ms, grip, script=PRESS)
    far.run(16)
    rows = far.rows
    assert felt_n_m(rows) == pytest.approx(near_n_m(grip), rel=0.2)
    # The first press ends on a wall that has just come.
    swing_n = np.ptp(pressed(rows)[1:, -500:, 1], axis=1)
    assert swing_n.max() < 0.1
    assert largest_step_n(rows) < 1.0
    assert far.space.controller.port.in_j > 0.2
    check_energy(far)
    # The robot presses as the hand feels.
    assert far.ground.robot.force_n == pytest.approx(-rows[-1, 1], rel=0.1)


PUSH_6_N = HandModel(stiffness_n_m=1000.0, damping_n_s_m=20.0, mass_kg=0.4, push_n=6.0)


@pytest.mark.parametrize("round_trip_ms", [0, 150, 800])
@pytest.mark.parametrize("grip", [SOFT_GRIP, FIRM_GRIP, PUSH_6_N], ids=["soft", "firm", "push"])
@pytest.mark.parametrize("stiffness_n_m", [200.0, 1900.0])
def test_the_first_press_feels_the_wall_at_any_delay_without_drag(
    grip, round_trip_ms, stiffness_n_m
):
    far = MediatedPair(
        round_trip_ms, grip, residual=True, stiffness_n_m=stiffness_n_m, script=PRESS
    )
    far.run(4)
    rows = far.rows
    felt = felt_n_m(rows)[0] / (1000.0 * stiffness_n_m / (1000.0 + stiffness_n_m))
    assert felt > (0.8 if round_trip_ms < 400 else 0.5)
    assert largest_step_n(rows) < 1.1
    check_energy(far)
    speeds = np.diff(rows[:, 0]) * 1000.0
    free = (rows[1:, 0] < WALL_X_M) & (speeds > 0.03)
    work_w = -rows[1:, 1][free] * speeds[free]
    assert work_w.sum() / (speeds[free] ** 2).sum() < 8.5


def largest_change_n(controller, courses):
    """Return by how much the force changes at most. courses: feedback and handle, each ms."""
    forces = [controller.step(feedback, x_m, 0.0, MS) for feedback, x_m in courses]
    return np.hypot(*np.diff([(0.0, 0.0), *forces], axis=0).T).max()


def tell_wall(controller, stiffness_n_m):
    controller.handle_wall(pack_wall(WallMessage(1, Wall(0.0, 0.0, stiffness_n_m)), 1))


def test_wall_rest_and_damping_together_change_the_force_by_1_1_n_a_ms():
    controller = MediatedController(residual=True)
    tell_wall(controller, 1500.0)

    def course():
        for ms in range(4000):
            # There is energy enough, so nothing but the rates bounds a change; damping is whole.
            controller.port.credit_j = controller.renderer.tank_j = 0.5
            feedback = Feedback(4.0 * (-1) ** (ms // 40), 0.0, 0, True, acted=True)
            yield feedback, 0.004 + 0.006 * sin(0.07 * ms)

    assert 1.0 < largest_change_n(controller, course()) <= 1.1


@pytest.mark.parametrize(("force_n", "stiffness_n_m", "out_m"), [(3, 80, 0), (2, 80, 1e-5)])
def test_a_wall_that_rises_leaves_the_rest_what_it_needs_to_fade(force_n, stiffness_n_m, out_m):
    controller = MediatedController(residual=True)

    def course():
        for ms in range(400):
            controller.port.credit_j = 0.03
            if ms == 20:
                tell_wall(controller, stiffness_n_m)
                controller.renderer.tank_j = 0.07
            yield Feedback(-force_n, 0.0, 0, False), 0.06 - max(0, ms - 20) * out_m

    assert largest_change_n(controller, course()) <= 1.1


def test_a_wall_that_a_hand_leaves_at_once_fades_by_1_1_n_a_ms():
    controller = MediatedController()
    tell_wall(controller, 1500.0)

    def course():
        for ms in range(900):
            if ms < 800:
                controller.renderer.tank_j = 0.0064
            yield Feedback(0.0, 0.0, 0, False), 0.0135 - 20e-6 * max(0, ms - 800) ** 2

    assert 1.0 < largest_change_n(controller, course()) <= 1.1


def test_motors_that_get_weaker_at_a_resting_handle_leave_no_force_beyond_their_limit():
    controller = MediatedController(residual=True)
    for ms in range(900):
        if ms == 20:
            tell_wall(controller, 1500.0)
        # The rest lacks its credit at first, so it still returns when the limit falls.
        controller.port.credit_j = 0.0 if ms < 790 else 0.03
        controller.renderer.tank_j = 0.5
        controller.limit_n = limit_n = 12.0 if ms < 800 else 3.0
        force = controller.step(Feedback(-3.0, 0.0, 0, False), 0.06, 0.0, MS)
        assert hypot(*force) <= limit_n + 1e-9
        if ms == 799:
            assert hypot(*force) > 11.0


def test_a_robot_that_has_started_is_felt_once_not_twice():
    pair = MediatedPair(60, SOFT_GRIP, residual=True, script=PRESS)
    pair.run(3)
    controller = pair.space.controller
    controller.handle_restart()
    feedback = Feedback(-5.0, 3.0, 0, True)
    for _ in range(50):
        controller.step(feedback, pair.handle.x_m, pair.handle.y_m, MS)
    assert controller.robot_force_n == controller.renderer.force_n
    controller.handle_wall(pair.ground.estimator.poll_transmit(10**12))
    for _ in range(50):
        controller.step(feedback, pair.handle.x_m, pair.handle.y_m, MS)
    assert controller.robot_force_n != controller.renderer.force_n


def test_the_wall_is_where_the_robot_meets_it_whatever_the_hand_pressed_at():
    script = (
        Waypoint(0.02, 0.0, 500 * MS, 1500 * MS),
        Waypoint(0.105, 0.0, 500 * MS, 2000 * MS),
        Waypoint(0.01, 0.0, 500 * MS, 1500 * MS),
        Waypoint(0.035, 0.0, 500 * MS, 3000 * MS),
    )
    envelope = SafetyEnvelope()
    pair = MediatedPair(60, SOFT_GRIP, residual=True, script=script, envelope=envelope)
    for seconds, pressed_now in ((1.0, False), (3.5, True), (1.5, False), (4.0, True)):
        pair.handle.dead_man = pressed_now
        pair.run(0.2)
        offset_m = envelope.offset_m[0]
        if (wall := pair.ground.estimator.wall) is not None:
            # It is known before the next contact.
            assert wall.depth_m(WALL_X_M - offset_m, 0.0) == pytest.approx(0.0, abs=1e-3)
        pair.run(seconds - 0.2)
        if pressed_now:
            felt = -pair.handle.motor_x_n / (pair.handle.x_m + offset_m - WALL_X_M)
            assert abs(offset_m) > 0.01
            assert felt == pytest.approx(600.0, rel=0.05)


def test_a_session_carries_walls_as_telemetry():
    setup = load_setup("spacejustin", changes={"hand": "auto", "radio_delay_ms": 150.0})
    report = simulate(setup, seconds=6, seed=1, media=False)
    assert not report.failures
    counts = report.processes["joystick"].counts
    assert counts["walls"] >= 4
    assert counts["walls_garbage"] == counts["walls_stale"] == 0
    assert report.processes["console"].counts["pus_garbage"] == 0

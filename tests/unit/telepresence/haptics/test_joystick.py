"""The simulated joystick: its handle, its stops, and motors that grow hot."""

from math import hypot

import pytest

from telepresence.haptics.joystick import Joystick, JoystickModel

MS = 1_000_000
SMOOTH = JoystickModel(viscous_n_s_m=0.0, coulomb_n=0.0)


def pushed(joystick, milliseconds, motors=(0.0, 0.0), hand=(0.0, 0.0), hand_kg=0.0):
    for _ in range(milliseconds):
        joystick.push(*motors, *hand, hand_kg, MS)
    return joystick


@pytest.mark.parametrize(("hand_kg", "virtual_kg"), [(0.0, 0.0), (0.3, 0.0), (0.2, 0.1)])
def test_force_accelerates_the_mass_of_handle_hand_and_guide(hand_kg, virtual_kg):
    joystick = Joystick(SMOOTH, x_m=0.01, y_m=-0.02)
    joystick.virtual_kg = virtual_kg
    pushed(joystick, 50, (1.0, -2.0), (3.0, 0.5), hand_kg)
    mass_kg = 0.4 + hand_kg + virtual_kg
    vx, vy = joystick.vx_m_s, joystick.vy_m_s
    assert (mass_kg * vx, mass_kg * vy) == pytest.approx((4.0 * 0.05, -1.5 * 0.05))
    assert joystick.x_m - 0.01 == pytest.approx(vx * 0.0255)
    assert joystick.y_m + 0.02 == pytest.approx(vy * 0.0255)
    assert joystick.work_j == pytest.approx(1.0 * vx * 0.0255 - 2.0 * vy * 0.0255)
    assert (joystick.motor_x_n, joystick.motor_y_n) == (1.0, -2.0)


def test_friction_brakes_along_the_motion_until_it_rests():
    """1 N s/m and 0.2 N, softened below 5 mm/s."""
    joystick = Joystick()
    joystick.vx_m_s, joystick.vy_m_s = 0.3, -0.4
    pushed(joystick, 1)
    drag = (1.0 + 0.2 / 0.505) * 1e-3 / 0.4
    assert (joystick.vx_m_s, joystick.vy_m_s) == pytest.approx((0.3 - drag * 0.3, drag * 0.4 - 0.4))
    pushed(joystick, 2000)
    assert hypot(joystick.vx_m_s, joystick.vy_m_s) < 1e-5
    assert joystick.y_m / joystick.x_m == pytest.approx(-4 / 3)


def test_motors_are_limited_together_and_lose_strength_by_heat():
    joystick = pushed(Joystick(), 1, (30.0, -40.0))
    assert (joystick.motor_x_n, joystick.motor_y_n) == pytest.approx((7.2, -9.6))
    # 0.5 K for each N² with a time constant of 240 s, of the force that they have.
    assert joystick.temperature_c == pytest.approx(23.0 + 0.5 * 144.0 * 1e-3 / 240.0)
    for warm_c, limit_n in ((60.0, 12.0), (70.0, 7.5), (80.0, 3.0), (95.0, 3.0), (65.0, 9.75)):
        joystick.temperature_c = warm_c
        pushed(joystick, 1, (0.0, 12.0))
        assert joystick.force_limit_n == pytest.approx(limit_n, rel=1e-3)
    joystick.temperature_c = 40.0
    pushed(joystick, 1)
    assert joystick.force_limit_n == 12.0 and joystick.temperature_c < 40.0


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("axis", [0, 1])
def test_a_stop_pushes_back_and_never_pulls(axis, sign):
    end = (SMOOTH.half_width_m, SMOOTH.half_height_m)[axis]
    # 5000 N/m and 40 N s/m: 5 N of the depth, ∓4 N of the speed; then too fast to be followed.
    for depth_m, speed_m_s, force_n in (
        (0.001, 0.1, 9.0),
        (0.001, -0.1, 1.0),
        (0.001, -0.5, 0.0),
        (0.0, 0.0, 0.0),
    ):
        position, speed = [0.0, 0.0], [0.0, 0.0]
        position[axis], speed[axis] = sign * (end + depth_m), sign * speed_m_s
        joystick = Joystick(SMOOTH, x_m=position[0], y_m=position[1])
        joystick.vx_m_s, joystick.vy_m_s = speed
        pushed(joystick, 1)
        got = (joystick.vx_m_s, joystick.vy_m_s)
        assert got[axis] == pytest.approx(sign * (speed_m_s - force_n / 0.4 * 1e-3))
        assert got[1 - axis] == 0.0

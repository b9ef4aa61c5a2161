"""The force at the handle: limited, passive, damped, and alike along both axes."""

from itertools import pairwise
from math import hypot

import pytest
from haptic_pair import MS
from haptic_session import begin_session
from haptic_walks import walks

from telepresence.haptics.bilateral import JoystickSide
from telepresence.haptics.joystick_controller import JoystickController, JoystickControllerModel
from telepresence.haptics.sample import STATE_APPLICATION, Feedback, pack_feedback

MODEL = JoystickControllerModel()


class Rail:
    """A handle that glides at 0.2 m/s along +x, whatever force acts on it."""

    x_m = y_m = 0.0
    force_limit_n, dead_man, buttons, state = 12.0, True, 0, STATE_APPLICATION
    stop = blind = False
    more = ()

    def __init__(self):
        self.felt = []

    def step(self, fx_n, fy_n, dt_ns):
        self.felt.append(fx_n)
        self.x_m += 0.2 * dt_ns / 1e9


@pytest.mark.parametrize("credit_j", [0.0, 1e-4, 1e-3, 1e-2])
@pytest.mark.parametrize("phase", range(0, 8, 2))
def test_force_and_damping_together_cost_no_more_than_the_credit(credit_j, phase):
    """The hand turns around so fast that the damping, which lags, pushes it on."""
    side = JoystickController(JoystickControllerModel(rate_n_s=1e6))
    margin_m = side.model.acceleration_m_s2 * 1e-6
    x_m, v_m_s, costs = 0.0, 0.0, 0
    for cycle in range(400):
        v_m_s += 0.12 if (cycle // 8) % 2 else -0.12
        before_m, x_m = x_m, x_m + v_m_s * 1e-3
        side.port.credit_j = credit_j
        feedback = Feedback(8.0 if (cycle + phase) // 8 % 2 else -8.0, 0.0, 0, True)
        force_n, _ = side.step(feedback, x_m, 0.0, MS)
        left_j = side.port.credit_j
        cost_j = force_n * (x_m - before_m) + abs(force_n) * margin_m
        costs += cost_j > 0.9 * left_j > 0.0
        # Half a microjoule is rounding.
        assert cost_j <= left_j + 0.6e-6
    assert costs or credit_j != 1e-4


def test_a_cycle_that_is_late_causes_no_jerk_of_the_damping():
    for advances_ns in ([MS], [1_020_000], [980_000, 1_050_000], [MS, MS, 4 * MS]):
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


def test_the_displayed_force_is_limited_in_size_and_in_rate_and_decays_in_silence():
    side = JoystickController(passive=False)
    side.limit_n = 9.0
    push = Feedback(-9.0, 12.0, 0, True)
    assert side.step(push, 0.0, 0.0, MS) == (0.0, 0.0)
    force = side.step(push, 0.0, 0.0, MS)
    assert force == pytest.approx((-0.6 * MODEL.rate_n_s / 1000, 0.8 * MODEL.rate_n_s / 1000))
    for _ in range(100):
        force = side.step(push, 0.0, 0.0, MS)
    assert force == pytest.approx((-5.4, 7.2))
    forces = [side.step(None, 0.0, 0.0, MS)[1] for _ in range(2000)]
    assert all(later <= earlier + 1e-9 for earlier, later in pairwise(forces))
    assert forces[-1] < 0.01


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
    assert joystick_side.port.least_j >= -1e-6
    return sizes[299:]


def test_a_force_fades_like_a_spring_whose_energy_is_the_credit():
    # A hand at rest feels what the credit can let fade.
    resting = displayed(-6.0, 0.0, 0.004, 0.0)
    next_cycle_j = resting[-1] * MODEL.acceleration_m_s2 * 1e-6
    fade_j = resting[-1] ** 2 / (2.0 * MODEL.fade_n_m)
    assert next_cycle_j + fade_j == pytest.approx(0.004, rel=1e-3)
    assert displayed(-6.0, 0.0, 0.1, 0.0)[-1] == pytest.approx(6.0)
    # A hand that gives way uses the credit up: the force fades to nothing, and never suddenly.
    for speed_m_s in (0.05, 0.3, 1.0):
        fading = displayed(6.0, 0.0, 0.05, speed_m_s)
        assert fading[0] == pytest.approx(6.0)
        assert fading[-1] < 0.1
        assert max(a - b for a, b in pairwise(fading)) <= MODEL.rate_n_s * 1e-3 + 1e-9
    # A hand that pushes against the force pays for it.
    assert displayed(-6.0, 0.0, 0.004, 0.1)[-1] == pytest.approx(6.0)
    # A force across the motion costs nothing, so it stays.
    assert displayed(0.0, 6.0, 0.05, 0.3)[-1] == pytest.approx(6.0)


def test_the_damping_follows_what_either_end_lacks():
    side = JoystickController()
    side.step(None, 0.0, 0.0, MS)
    whole, starved = Feedback(0.0, 0.0, 0, False), Feedback(0.0, 0.0, 0, False, acted=True)
    least, most, reserve_j = MODEL.damping_n_s_m, MODEL.most_damping_n_s_m, MODEL.reserve_j
    for feedback, credit_j, cycles, damping in (
        (whole, reserve_j, 2000, least),
        (whole, 0.0, 2000, most),
        (whole, reserve_j, 10_000, least),
        (starved, reserve_j, 2000, most),
        # Without samples nobody knows what is lacking.
        (None, 0.0, 2000, least),
    ):
        for _ in range(cycles):
            side.port.credit_j = credit_j
            side.step(feedback, 0.0, 0.0, MS)
        assert side.damping_n_s_m == pytest.approx(damping, rel=0.01)


def test_it_returns_what_it_does_not_need_to_a_robot_that_lacks():
    def granted_j(acted, force_n):
        side = JoystickController()
        side.port.credit_j = MODEL.reserve_j
        for _ in range(1000):
            side.step(Feedback(-force_n, 0.0, 0, True, acted=acted), 0.0, 0.0, MS)
        return side.port.granted_uj * 1e-6

    assert granted_j(False, 0.0) == 0.0
    assert granted_j(True, 0.0) == pytest.approx(MODEL.reserve_j, rel=0.01)
    needed_j = 8.0**2 / (2.0 * MODEL.fade_n_m)
    assert granted_j(True, 8.0) == pytest.approx(MODEL.reserve_j - needed_j, rel=0.02)


def test_exchanged_axes_exchange_the_forces_on_the_handle():
    upright, turned = JoystickController(), JoystickController()
    largest_n = 0.0
    for cycle, ((x, _), (y, _), (force_x, _), (force_y, _)) in enumerate(walks()):
        total = 20 * cycle
        fx, fy = upright.step(Feedback(100 * force_x, 100 * force_y, total, True), x, y, MS)
        gx, gy = turned.step(Feedback(100 * force_y, 100 * force_x, total, True), y, x, MS)
        assert abs(fx - gy) < 1e-9 and abs(fy - gx) < 1e-9
        largest_n = max(largest_n, abs(fx))
    assert largest_n > 1

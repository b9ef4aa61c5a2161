"""The books of a port balance, and the damping on the hand is paid for like any other force."""

from math import inf

import pytest
from hypothesis import given
from hypothesis import strategies as st

from telepresence.haptics.joystick_controller import JoystickController, JoystickControllerModel
from telepresence.haptics.passivity import Port
from telepresence.haptics.sample import Feedback

MS = 1_000_000

flows = st.one_of(
    st.tuples(st.just("flow"), st.floats(-0.01, 0.01)),
    st.tuples(st.just("total"), st.integers(0, 20_000)),
    st.tuples(st.just("return"), st.floats(0.0, 0.002)),
)


@given(st.lists(flows, max_size=60), st.sampled_from([0.0, 0.004]), st.sampled_from([0.01, inf]))
def test_every_joule_of_a_port_is_in_one_place(script, reserve_j, limit_j):
    port = Port(reserve_j=reserve_j, limit_j=limit_j)
    total_uj = 0
    port.handle_total(total_uj, MS)
    in_j = out_j = told_j = returned_j = 0.0
    least_j = 0.0
    for kind, amount in script:
        if kind == "flow":
            port.handle_flow(amount)
            out_j += max(amount, 0.0)
            in_j += max(-amount, 0.0)
            if amount > 0.0:
                least_j = min(least_j, port.credit_j)
        elif kind == "total":
            total_uj += amount
            port.handle_total(total_uj, 100 * MS)
            told_j += amount * 1e-6
        else:
            port.return_credit(amount)
            returned_j += amount
        credit_j = port.received_j + port.kept_j - port.forgotten_j - port.returned_j - port.out_j
        assert port.credit_j == pytest.approx(credit_j, abs=1e-12)
        assert port.credit_j <= max(limit_j, reserve_j) + 1e-12
    assert (port.in_j, port.out_j) == pytest.approx((in_j, out_j), abs=1e-12)
    assert (port.received_j, port.returned_j) == pytest.approx((told_j, returned_j), abs=1e-9)
    # What entered is kept here or granted to the peer; what is returned is granted as well.
    assert port.granted_j == pytest.approx(in_j - port.kept_j + returned_j, abs=1e-12)
    assert port.granted_uj == int(port.granted_j * 1e6)
    assert port.least_j == pytest.approx(least_j, abs=1e-12)
    assert min(port.kept_j, port.forgotten_j) >= 0.0
    assert port.refused == 0


def test_incoming_energy_fills_the_reserve_and_only_the_rest_is_granted():
    port = Port(reserve_j=0.004)
    port.handle_flow(-0.003)
    assert (port.kept_j, port.granted_j, port.credit_j) == (0.003, 0.0, 0.003)
    port.handle_flow(-0.003)
    assert (port.kept_j, port.granted_j) == pytest.approx((0.004, 0.002))
    port.handle_flow(-0.003)
    assert (port.kept_j, port.granted_j) == pytest.approx((0.004, 0.005))


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

"""Steps of the received force: dated at their start, and counted once."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kontur_av.clock import NS_PER_MS, NS_PER_S
from telepresence.haptics.step_detector import StepDetector


def steps(samples):
    """Return (index of the sample, rise) of each step; samples: (fx, fy, contact), at 1 kHz."""
    detector = StepDetector()
    for number, (fx, fy, contact) in enumerate(samples):
        detector.handle_sample(number * NS_PER_MS, fx, fy, contact)
    return [(step.instant_ns // NS_PER_MS, step.rise_n) for step in iter(detector.next_event, None)]


def press(contact=True, force=3.0, rise=5, hold=300):
    ramp = [(-force * (k + 1) / rise, 0.0, contact) for k in range(rise)]
    return ramp + [(-force, 0.0, contact)] * hold


def free(count=200, contact=False):
    return [(0.0, 0.0, contact)] * count


def test_only_the_newest_256_steps_wait_to_be_fetched():
    pushes = [*free(150), *press(hold=20)] * 260
    found = steps(pushes)
    assert len(found) == 256
    assert found[-1][0] > len(pushes) - 100


@given(
    rise=st.integers(1, 40), force=st.floats(0.3, 60), hold=st.integers(1, 400), flag=st.booleans()
)
def test_a_step_is_dated_at_its_first_sample(rise, force, hold, flag):
    yes, no = (True, False) if flag else (None, None)
    found = steps(free(contact=no) + press(yes, force, rise, hold) + free(contact=no))
    assert len(found) == 1
    # Changes below the noise level are not detected yet.
    assert 200 <= found[0][0] <= 200 + 0.02 / force * rise + 1


@pytest.mark.parametrize(
    ("samples", "found"),
    [
        ((free() + press()) * 4, [200, 705, 1210, 1715]),
        # A bounce is no second step, a retreat none, and without contact no change of force.
        (free() + press(hold=10) + free(30) + press(), [200]),
        (free(contact=None) + press(None, hold=800) + free(400, None), [200]),
        (free() + press(False) + free(), []),
        (free() + press(hold=800) + [(0.5, 0.0, True)] * 200 + free(), [200]),
        (free() + press(rise=2000) + [(0.5, 0.0, True)] * 200 + free(), []),
        # Slow drift and rounding.
        ([(0.0005 * k, 0.0, None) for k in range(4000)], []),
        ([(0.002 * (k % 2), 0.0, True) for k in range(1000)], []),
    ],
)
def test_each_press_is_one_step_and_nothing_else_is(samples, found):
    assert [index for index, _ in steps(samples)] == found


def test_a_constant_force_before_the_contact_hides_no_step():
    moving = [(0.5, 0.1, False)] * 200
    ((index, rise),) = steps(moving + [(0.5 - 0.1 * k, 0.1, True) for k in range(1, 30)])
    assert index == 200
    assert rise >= 0.2


@pytest.mark.parametrize("rate_hz", [10, 50, 80, 200, 1000, 4000])
def test_a_press_is_a_step_at_any_rate_of_samples(rate_hz):
    detector, period_ns = StepDetector(), NS_PER_S // rate_hz
    pressed = [number // rate_hz % 2 == 1 for number in range(20 * rate_hz)]
    for number, there in enumerate(pressed):
        detector.handle_sample(number * period_ns, 5.0 * there)
    found = [step.instant_ns for step in iter(detector.next_event, None)]
    assert found == [second * NS_PER_S for second in range(1, 20, 2)]

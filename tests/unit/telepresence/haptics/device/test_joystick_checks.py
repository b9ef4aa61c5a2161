"""The functional checks pass on a sound joystick, and each finds the fault that it is for."""

import pytest

from kontur_av.clock import NS_PER_MS, NS_PER_S
from telepresence.haptics.device.checks import CHECKS, CheckBench
from telepresence.haptics.device.simulated import FACTS, FAULTS, Faults, SimulatedDevice


def checked(names, faults=None, device=None, during=None):
    """The results of the checks called `names`, by name; `during(bench, device)` in each cycle."""
    device = device or SimulatedDevice(faults)
    bench = CheckBench(device, names)
    now_ns = 0
    while not bench.done:
        now_ns += NS_PER_MS
        assert now_ns < 120 * NS_PER_S
        if during is not None:
            during(bench, device)
        bench.handle_cycle(now_ns, NS_PER_MS)
    return {result.name: result for result in bench.results}


def test_a_sound_joystick_passes_all_and_the_figures_are_its_own():
    device = SimulatedDevice()
    results = checked(list(CHECKS), device=device)
    assert [name for name, result in results.items() if result.passed] == list(CHECKS)
    figures = {
        figure.name: figure.value for result in results.values() for figure in result.figures
    }
    assert figures["Coulomb friction x"] == pytest.approx(FACTS.coulomb_n, rel=0.15)
    assert figures["viscous friction y"] == pytest.approx(FACTS.viscous_n_s_m, rel=0.15)
    assert figures["stiffness x"] == pytest.approx(200, rel=0.02)
    # Pushed with 4 N the handle goes into its stops by a little, never less far than to them.
    assert 150 <= figures["right end"] < 152
    assert abs(device.joystick.x_m) < 0.005 and abs(device.joystick.y_m) < 0.005


@pytest.mark.parametrize(
    ("check", "fault", "words"),
    [
        ("friction", "friction", "Coulomb friction x"),
        ("spring", "weak", "stiffness y"),
        ("buttons", "button", "button 2 pressed and let go"),
    ],
)
def test_a_fault_fails_the_check_that_is_for_it(check, fault, words):
    result = checked([check], FAULTS[fault])[check]
    assert result.failed
    assert words in [figure.name for figure in result.figures if not figure.passed]
    assert not result.trouble


@pytest.mark.parametrize("axis", [0, 1])
def test_an_axis_that_is_stuck_is_never_calibrated(axis):
    result = checked(["workspace"], Faults(stuck=axis))["workspace"]
    assert result.failed
    assert f"calibration error: axis {'xy'[axis]} moves by ±0 mm" in result.trouble


@pytest.mark.parametrize("check", ["workspace", "friction", "spring"])
def test_an_axis_that_sticks_after_the_calibration_fails_what_moves_it(check):
    def stick(bench, device):
        if bench.operation.calibration is not None:
            device.stuck = 1

    result = checked([check], during=stick)[check]
    assert result.failed


def test_hot_motors_end_a_check_with_the_reason():
    def heat(bench, device):
        if bench.results:
            device.joystick.temperature_c = 85.0

    results = checked(["spring", "friction"], during=heat)
    assert results["spring"].passed
    assert "halted: the motors were at 85 °C" in results["friction"].trouble
    cold = checked(["spring"], FAULTS["hot"])["spring"]
    assert cold.failed and "103 °C" in cold.trouble


def test_an_unplugged_joystick_fails_all_that_is_left():
    results = checked(list(CHECKS), FAULTS["unplugged"])
    assert len(results) == len(CHECKS)
    assert all("the device is gone" in result.trouble for result in results.values())


def test_buttons_that_are_pressed_unasked_are_counted():
    def lean(bench, device):
        if bench.prompt.startswith("press button"):
            device.fingers.buttons |= 0b1000

    result = checked(["buttons"], during=lean)["buttons"]
    failed = [figure.name for figure in result.figures if not figure.passed]
    assert "other buttons with 1" in failed

"""The functional checks pass on a healthy joystick, and each detects its own fault."""

import pytest
from joystick_scripts import MS, REST, STICK

from kontur_av.clock import NS_PER_MS, NS_PER_S
from telepresence.haptics.device.checks import CHECKS, CheckBench
from telepresence.haptics.device.simulated import CAPABILITIES, FAULTS, SimulatedDevice


def checked(names, faults=None, device=None, during=None):
    """Return the results of the checks by name; `during(bench, device)` runs in each cycle."""
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


def test_a_healthy_joystick_passes_all_checks_with_its_own_metrics():
    device = SimulatedDevice()
    results = checked(list(CHECKS), device=device)
    assert [name for name, result in results.items() if result.passed] == list(CHECKS)
    metrics = {
        figure.name: figure.value for result in results.values() for figure in result.metrics
    }
    assert metrics["Coulomb friction x"] == pytest.approx(CAPABILITIES.coulomb_n, rel=0.15)
    assert metrics["viscous friction y"] == pytest.approx(CAPABILITIES.viscous_n_s_m, rel=0.15)
    assert metrics["stiffness x"] == pytest.approx(200, rel=0.02)
    # A push of 4 N moves the handle slightly into its stops, never less far than to them.
    assert 150 <= metrics["right end"] < 152
    assert abs(device.joystick.x_m) < 0.005 and abs(device.joystick.y_m) < 0.005


def test_hot_motors_end_a_check_with_the_reason():
    def heat(bench, device):
        if bench.results:
            device.joystick.temperature_c = 85.0

    results = checked(["spring", "friction"], during=heat)
    assert results["spring"].passed
    assert "halted: the motors were at 85 °C" in results["friction"].trouble
    cold = checked(["spring"], FAULTS["hot"])["spring"]
    assert cold.failed and "103 °C" in cold.trouble


def test_an_unplugged_joystick_fails_all_remaining_checks():
    results = checked(list(CHECKS), FAULTS["unplugged"])
    assert len(results) == len(CHECKS)
    assert all("the device is gone" in result.trouble for result in results.values())


def test_a_device_that_never_becomes_ready_fails_each_check_after_forty_seconds():
    """Here nobody lets go of the stick, which would be calibrated again and again."""
    device = SimulatedDevice()
    device.capabilities = STICK
    device.read = lambda: REST._replace(x_m=0.05)
    bench = CheckBench(device, ["workspace", "buttons"])
    assert (bench.done, bench.current) == (False, "workspace")
    for ms in range(0, 40_001, 20):
        bench.handle_cycle(ms * MS, MS)
    assert not bench.results
    bench.handle_cycle(40_020 * MS, MS)
    assert [result.name for result in bench.results] == ["workspace", "buttons"]
    assert all("does not rest at its middle" in result.trouble for result in bench.results)
    assert bench.done and bench.current == bench.prompt == ""

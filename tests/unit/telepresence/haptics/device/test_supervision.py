"""What the supervision says of readings, apart from any joystick."""

import re
from math import inf, nan

import numpy as np
import pytest

from telepresence.haptics.device.device import JoystickReading
from telepresence.haptics.device.supervision import (
    Health,
    JoystickSupervisor,
    Limits,
    NoiseMeter,
)

MS = 1_000_000
REST = JoystickReading(0.0, 0.0, 0.0, 0.0, temperature_c=20.0)


@pytest.mark.parametrize(
    ("temperature_c", "share"),
    [(None, 1.0), (20.0, 1.0), (60.0, 1.0), (70.0, 0.625), (79.999, 0.25), (80.0, 0.0), (95, 0.0)],
)
def test_heat_takes_force_from_the_warning_to_the_halt(temperature_c, share):
    assert Limits().share(temperature_c) == pytest.approx(share, abs=1e-4)


@pytest.mark.parametrize(("cool_c", "warn_c", "halt_c"), [(60, 60, 80), (55, 80, 80), (90, 60, 80)])
def test_limits_that_contradict_each_other_are_refused(cool_c, warn_c, halt_c):
    with pytest.raises(ValueError, match="cool_c < warn_c < halt_c"):
        Limits(cool_c=cool_c, warn_c=warn_c, halt_c=halt_c)


def test_the_thermometer_is_read_every_20_ms_and_a_halt_ends_below_its_own_limit():
    supervisor, seen = JoystickSupervisor(), []
    warmth = [20.0] * 20 + [60.5] * 20 + [80.0] * 20 + [55.0] * 20 + [54.9] * 20 + [60.1] * 20
    for ms, temperature_c in enumerate(warmth):
        health = supervisor.handle_reading(REST._replace(temperature_c=temperature_c), ms * MS)
        assert health is supervisor.health
        if ms % 20 in (0, 19):
            seen.append((health.name, round(supervisor.share, 2), supervisor.warnings))
    assert seen == [
        *[("OK", 1.0, 0)] * 2,
        *[("OK", 0.98, 1)] * 2,
        *[("HALT", 0.0, 1)] * 2,
        *[("HALT", 1.0, 1)] * 2,
        *[("OK", 1.0, 1)] * 2,
        *[("OK", 1.0, 2)] * 2,
    ]
    assert supervisor.hottest_c == 80.0 and supervisor.reason == ""
    # Between two readings of it, a spike is not seen.
    supervisor = JoystickSupervisor()
    for ms in range(60):
        reading = REST._replace(temperature_c=90.0 if ms % 20 else 20.0)
        assert supervisor.handle_reading(reading, ms * MS) is Health.OK
    assert JoystickSupervisor().hottest_c is None


def test_only_an_expected_peer_may_not_be_silent():
    supervisor = JoystickSupervisor(Limits(silence_ns=100 * MS))

    def health(ms):
        return supervisor.handle_reading(REST, ms * MS)

    assert {health(ms) for ms in range(0, 1000, 10)} == {Health.OK}
    supervisor.expects_peer = True
    # It counts from now on, and from each sample.
    assert [health(ms) for ms in (1000, 1100)] == [Health.OK] * 2
    supervisor.handle_heard(1100 * MS)
    assert [health(ms) for ms in (1200, 1201, 1300)] == [Health.OK, Health.HALT, Health.HALT]
    assert supervisor.reason == "no sample from the robot for 0.1 s"
    supervisor.handle_heard(1300 * MS)
    assert health(1400) is Health.OK and health(1401) is Health.HALT
    # Another peer begins anew, and is named.
    supervisor.peer = "the partner's robot"
    supervisor.handle_new_peer()
    assert supervisor.health is Health.OK and supervisor.reason == ""
    assert [health(ms) for ms in (1500, 1600, 1601)] == [Health.OK, Health.OK, Health.HALT]
    assert "the partner's robot" in supervisor.reason
    supervisor.handle_heard(1602 * MS)
    supervisor.forget_silence()
    assert [health(ms) for ms in (1700, 1800, 1801)] == [Health.OK, Health.OK, Health.HALT]


def test_a_new_peer_does_not_cool_the_motors():
    supervisor = JoystickSupervisor(Limits(silence_ns=100 * MS))
    supervisor.expects_peer = True
    for ms in (0, 101):
        supervisor.handle_reading(REST._replace(temperature_c=81.0), ms * MS)
    assert supervisor.health is Health.HALT and "81 °C" in supervisor.reason
    assert "below 55 °C" in supervisor.reason
    supervisor.handle_new_peer()
    assert supervisor.health is Health.HALT


@pytest.mark.parametrize(
    ("changes", "health", "words"),
    [
        ({"x_m": 0.109, "y_m": -0.089, "vx_m_s": 8.0, "vy_m_s": -8.0}, Health.OK, ""),
        ({"x_m": -0.109, "y_m": 0.089, "vx_m_s": -8.0, "vy_m_s": 8.0}, Health.OK, ""),
        ({"x_m": 0.111}, Health.FAULT, "axis x reads +111 mm, the workspace ends at ±100 mm"),
        ({"y_m": -0.091}, Health.FAULT, "axis y reads -91 mm, the workspace ends at ±80 mm"),
        ({"vx_m_s": 8.1}, Health.FAULT, "faster than a hand"),
        ({"vy_m_s": -8.1}, Health.FAULT, "faster than a hand"),
        ({"x_m": nan}, Health.FAULT, "axis x reads no number"),
        ({"vy_m_s": inf}, Health.FAULT, "axis y reads no number"),
        ({"temperature_c": nan}, Health.FAULT, "the thermometer reads no number"),
        ({"temperature_c": None}, Health.OK, ""),
        ({"present": False}, Health.FATAL, "the device is gone"),
    ],
)
def test_a_reading_is_judged_by_the_workspace(changes, health, words):
    supervisor = JoystickSupervisor()
    supervisor.set_workspace(0.1, 0.08)
    assert supervisor.plausible == pytest.approx((0.11, 0.09, 8.0))
    assert supervisor.handle_reading(REST._replace(**changes), 0) is health
    assert words in supervisor.reason and (supervisor.health is health)
    # Without a calibration, a place is no fault.
    supervisor.forget_workspace()
    if set(changes) <= {"x_m", "y_m"} and nan not in changes.values():
        assert supervisor.handle_reading(REST._replace(**changes), MS) is Health.OK


def test_an_exercise_makes_every_reading_a_fault_until_its_end():
    supervisor = JoystickSupervisor()
    supervisor.set_workspace(0.1, 0.08)
    supervisor.handle_exercise(50 * MS)
    found = [supervisor.handle_reading(REST, ms * MS).name for ms in (0, 49, 50)]
    assert found == ["FAULT", "FAULT", "OK"]
    assert supervisor.plausible == pytest.approx((0.11, 0.09, 8.0))
    assert supervisor.handle_reading(REST._replace(x_m=0.2), 60 * MS) is Health.FAULT
    assert "+200 mm" in supervisor.reason
    # A device that is gone is worse than any exercise.
    supervisor.handle_exercise(1000 * MS)
    assert supervisor.handle_reading(REST._replace(present=False), 61 * MS) is Health.FATAL


@pytest.mark.parametrize(
    ("noise_m", "speed_m_s", "says"),
    [(10e-6, 0.0, ""), (100e-6, 0.0, "trembles by 9.|trembles by 10"), (100e-6, 0.01, "")],
)
def test_a_place_that_trembles_at_rest_is_named_with_its_noise(noise_m, speed_m_s, says):
    meter, draws = NoiseMeter(), np.random.default_rng(5).normal(0.0, noise_m, (2000, 2))
    # Some readings come late, which is no noise.
    found = [
        meter.handle_place(speed_m_s * (k - 3 * (k % 10 == 0)) * 1e-3 + x_m, y_m)
        for k, (x_m, y_m) in enumerate(draws)
    ]
    told = [words for words in found if words]
    assert len(told) == bool(says)
    assert not says or re.search(says, told[0])

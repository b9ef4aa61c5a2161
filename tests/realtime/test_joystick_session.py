"""The joystick of a live session reaches its application, or reports why it cannot."""

import pytest

pytestmark = pytest.mark.realtime


def test_it_calibrates_itself_and_reports_it(start):
    session = start("taskboard", "--seconds", "7")
    _, report = session.end()
    joystick = report["joystick"]
    assert joystick["state"] == "application"
    assert [entry["state"] for entry in joystick["log"]] == [
        "standby",
        "standby",
        "calibrated",
        "application",
    ]
    assert joystick["temperature_c"] > 20
    assert not [failure for failure in report["failures"] if failure.startswith("joystick")]


def test_a_failed_calibration_fails_the_session(start):
    session = start("taskboard", "--seconds", "7", "--joystick", "sim:stuck-x")
    code, report = session.end()
    assert code == 1
    assert "calibration error" in report["joystick"]["state"]
    assert any(
        failure.startswith("joystick: calibration error: axis x moves by ±0 mm")
        for failure in report["failures"]
    )

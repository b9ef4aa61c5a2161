"""A joystick that cannot reach its application fails the session, and says why.

One that can is in `test_session.py`.
"""

import pytest

pytestmark = pytest.mark.realtime


def test_a_failed_calibration_fails_the_session(start):
    session = start("taskboard", "--seconds", "7", "--joystick", "sim:stuck-x")
    code, report = session.end()
    assert code == 1
    assert "calibration error" in report["joystick"]["state"]
    assert any(
        failure.startswith("joystick: calibration error: axis x moves by ±0 mm")
        for failure in report["failures"]
    )

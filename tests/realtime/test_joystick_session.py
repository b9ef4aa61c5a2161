"""A joystick that cannot reach its application fails the session, and says why.

One that can is in `test_safety.py`.
"""

import pytest
from running_session import eventually

from pipelines.hand.hand_topics import unpack_status
from pipelines.session.topology import JOYSTICK_STATE_TOPIC
from telepresence.haptics.device.states import JoystickState

pytestmark = pytest.mark.realtime


def test_a_failed_calibration_fails_the_session(start, monkeypatch):
    session = start("taskboard", "--joystick", "sim:stuck-x")
    session.pids()
    with session.bus(monkeypatch) as bus:
        reader = bus.reader(JOYSTICK_STATE_TOPIC)

        def failed():
            octets = reader.latest_octets()
            return octets and unpack_status(octets).state == JoystickState.CALIBRATION_ERROR

        eventually(failed, "the error of the calibration")
    code, report = session.interrupt()
    assert code == 1
    assert "calibration error" in report["joystick"]["state"]
    assert any(
        failure.startswith("joystick: calibration error: axis x moves by ±0 mm")
        for failure in report["failures"]
    )

"""Programs of others at a session, each killed, and our process for each: the session goes on."""

import os
import signal
from collections import Counter

import pytest
from foxglove_client import address, needs_client
from prometheus_peer import needs_prometheus
from running_session import alive, assert_sound, eventually

pytestmark = pytest.mark.realtime

pytest.importorskip("zenoh_ros2_sdk", reason="zenoh-ros2-sdk is not installed")

from attached_programs import OURS, Attached, free_ports, options  # noqa: E402


@needs_client
@needs_prometheus
def test_whatever_is_killed_of_those_attached_the_session_goes_on(start, tmp_path):
    ports = free_ports()
    session = start("taskboard", *options(ports))
    pids = session.pids()
    session.wait_for_flow()
    # Pictures for others never take a core from the session.
    for name in ("ros2", "foxglove"):
        assert os.sched_getscheduler(pids[name]) == os.SCHED_IDLE
    first, second = Attached(ports, tmp_path / "first"), None
    try:
        first.join(address(session))
        first.wait_for_data()
        for process in first.processes.values():
            process.kill()
            process.wait()
            session.wait_for_flow()
        assert all(map(alive, pids.values()))
        for name in OURS:
            os.kill(pids[name], signal.SIGKILL)
            session.wait_for_flow()
        eventually(lambda: len(session.children()) == len(pids), "the restarts")
        # Those that come again are served by the new processes.
        second = Attached(ports, tmp_path / "second")
        second.join(address(session))
        second.wait_for_data()
        code, report = session.interrupt()
    finally:
        first.kill()
        if second is not None:
            second.kill()
    assert code == 0, (session.errors(), report["failures"])
    assert_sound(report)
    restarts = {name: one["restarts"] for name, one in report["processes"].items()}
    assert Counter(restarts) == Counter(dict.fromkeys(OURS, 1)), restarts

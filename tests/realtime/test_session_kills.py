"""Each process of a session is killed once without warning; then the launcher itself."""

import contextlib
import os
import shutil
import signal
import subprocess
import time
from pathlib import Path

import pytest
from running_session import alive, assert_sound, eventually

from kontur_av.clock import MonotonicClock
from pipelines.session.topology import ROBOT_TOPIC, SELECTED_TOPIC

pytestmark = pytest.mark.realtime

RECEIVED = [
    f"received/{name}"
    for name in ("uplink_video", "uplink_voice", "downlink_video", "downlink_voice")
]
#: The topic that first shows that a process works again, if not the end of the streams.
WITNESS = {
    "robot": ROBOT_TOPIC,
    "joystick": ROBOT_TOPIC,
    "stereo": "camera/stereo",
    "selector": SELECTED_TOPIC,
    "ground_mic": "input/ground_mic",
    "iss_camera": "input/iss_camera",
    "iss_mic": "input/iss_mic",
    **{f"camera_{name}": f"input/{name}" for name in ("left", "right", "static", "head")},
}
#: Streams whose end is seen only in the line of figures, once a second.
LINES = {
    "ground_display": ["downlink_video", "downlink_voice"],
    "space_display": ["uplink_video", "uplink_voice"],
    "joystick": ["haptic_up", "haptic_down"],
    "robot": ["haptic_up", "haptic_down"],
    "ground_gateway": ["haptic_up", "haptic_down"],
    "space_gateway": ["haptic_up", "haptic_down"],
}


def test_each_process_is_killed_once(start, monkeypatch):
    session = start("spacejustin")
    clock = MonotonicClock()
    pids = session.pids()
    session.wait_for_flow()
    back_s = {}
    with session.bus(monkeypatch) as bus:
        readers = {topic: bus.reader(topic) for topic in {*RECEIVED, *WITNESS.values()}}

        def captured_since(topic, instant_ns):
            lease = readers[topic].latest()
            if lease is None:
                return False
            with lease:
                return lease.stamp.capture_ns > instant_ns

        for name in session.names:
            killed_ns = clock.now_ns()
            os.kill(pids[name], signal.SIGKILL)
            others = {other: pid for other, pid in pids.items() if other != name}

            def newcomer(others=others, killed=pids[name]):
                assert session.process.poll() is None, session.errors()
                return [pid for pid in session.children() if pid not in (*others.values(), killed)]

            (pids[name],) = eventually(newcomer, f"the restart of {name}")
            started_ns = clock.now_ns()
            topics = [*RECEIVED, *([WITNESS[name]] if name in WITNESS else [])]
            for topic in topics:
                eventually(
                    lambda topic=topic, since_ns=started_ns: captured_since(topic, since_ns),
                    f"{topic} after {name} was killed",
                )
            back_s[name] = (clock.now_ns() - killed_ns) / 1e9
            if name == "console":
                assert session.select("stereo").returncode == 0
            if name in LINES:
                session.wait_for_flow(LINES[name])
            assert all(alive(pid) for pid in others.values()), name
            assert set(session.children()) == set(pids.values()), name
    print("back after, s:", {name: round(seconds, 2) for name, seconds in back_s.items()})
    code, report = session.interrupt()
    assert code == 0, (session.errors(), report["failures"])
    assert session.errors() == ""
    session.assert_nothing_left()
    assert_sound(report)
    processes = report["processes"]
    assert set(processes) == set(session.names)
    assert {name: entry["restarts"] for name, entry in processes.items()} == dict.fromkeys(
        session.names, 1
    )
    for name, entry in processes.items():
        assert "SIGKILL" in entry["last_error"], (name, entry)


def is_part(pid):
    try:
        return Path(f"/proc/{pid}/comm").read_text().startswith("kav ")
    except OSError:
        return False


def test_ctrl_c_at_once_leaves_nothing(start):
    session = start("taskboard")
    # Its first child is no process of the session, but a system program that looks for libopus.
    eventually(lambda: any(map(is_part, session.children())), "the first process")
    code, report = session.interrupt()
    assert code == 0, (session.errors(), report["failures"])
    assert session.errors() == ""
    assert set(report["streams"]) == {"uplink_video"}
    session.assert_nothing_left()


def test_processes_end_with_a_killed_launcher(start):
    session = start("taskboard")
    pids = session.pids()
    session.wait_for_flow()
    session.process.kill()
    session.process.wait()
    eventually(lambda: not any(alive(pid) for pid in pids.values()), "the end of all processes")


def test_a_repeatedly_failing_process_affects_no_other(start):
    session = start("taskboard")
    pids = session.pids()
    session.wait_for_flow()
    end_s = time.monotonic() + 2
    others = {pid for name, pid in pids.items() if name != "camera_static"}
    while time.monotonic() < end_s:
        for pid in set(session.children()) - others:
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, signal.SIGKILL)
        time.sleep(0.01)
    session.wait_for_flow()
    code, report = session.interrupt()
    assert code == 0
    assert_sound(report)
    restarts = {name: entry["restarts"] for name, entry in report["processes"].items()}
    # Each restart waits longer than the one before; two seconds have room for six.
    assert 2 <= restarts.pop("camera_static") <= 8
    assert set(restarts.values()) == {0}
    session.assert_nothing_left()


def test_a_session_goes_on_when_another_program_fills_shared_memory(start):
    own = 'mount -t tmpfs -o size=100m none /dev/shm && exec "$@"'
    mounted = ("unshare", "-rm", "sh", "-c", own, "sh")
    if subprocess.run([*mounted, "true"], capture_output=True, check=False).returncode:
        pytest.skip("no mount namespace is permitted here")
    session = start("taskboard", prefix=mounted)
    pids = session.pids()
    session.wait_for_flow()
    filler = Path(f"/proc/{pids['robot']}/root/dev/shm/filler")
    with contextlib.suppress(OSError), filler.open("wb", buffering=0) as file:
        while True:
            file.write(bytes(1 << 20) if shutil.disk_usage(filler).free >= 1 << 20 else bytes(4096))
    assert shutil.disk_usage(filler).free < 4096
    time.sleep(2)
    session.wait_for_flow()
    filler.unlink()
    code, report = session.interrupt()
    assert code == 0, (session.errors(), report["failures"])
    assert {entry["restarts"] for entry in report["processes"].values()} == {0}

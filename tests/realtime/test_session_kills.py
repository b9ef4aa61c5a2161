"""Every process of a session is killed once without warning; then the launcher itself."""

import contextlib
import shutil
import subprocess
from pathlib import Path

import pytest
from running_session import BOARD, SMALL, alive, eventually, free_pair, restarted, tcp_port

from kontur_av.clock import MonotonicClock
from pipelines.media.following import SELECTED_TOPIC
from pipelines.session.mission_messages import ROBOT_TOPIC

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
    "operator_camera": "input/operator_camera",
    "operator_mic": "input/operator_mic",
    **{f"camera_{name}": f"input/{name}" for name in ("left", "right", "head")},
}
#: Streams whose end is seen only in the line of figures.
HAPTICS = ("haptic_up", "haptic_down")
LINES = {
    "ground_display": ("downlink_video", "downlink_voice"),
    "space_display": ("uplink_video", "uplink_voice"),
    "joystick": HAPTICS,
    "robot": HAPTICS,
    "ground_gateway": HAPTICS,
    "space_gateway": HAPTICS,
}
#: As many processes as SpaceJustin has.
STEREO = SMALL.replace('"static"', '"stereo"')


def test_each_process_is_killed_once(start, tmp_path, monkeypatch):
    """The table says which there are: all but those of partners and of optional packages."""
    session = start(
        *(STEREO, "--page", "8330", "--tasks", "--record", "run.mcap", "--trainer"),
        *("--files", str(tmp_path / "files"), "--foxglove", str(tcp_port())),
        *("--packets", f"tcp:{tcp_port()}", "--frames", f"udp:127.0.0.1:{free_pair()}"),
    )
    clock, pids = MonotonicClock(), session.pids()
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
            session.kill(pids, name)
            started_ns = clock.now_ns()
            for topic in (*RECEIVED, WITNESS.get(name, RECEIVED[0])):
                eventually(
                    lambda topic=topic, since_ns=started_ns: captured_since(topic, since_ns),
                    f"{topic} after {name} was killed",
                )
            if name in LINES:
                session.wait_for_flow(LINES[name])
            back_s[name] = round((clock.now_ns() - killed_ns) / 1e9, 2)
            assert {*session.children()} == {*pids.values()}, name
    assert session.select("stereo").returncode == 0
    print("back after, s:", back_s)
    report = session.finish(silent=True, clean=True, sound=True)
    processes = report["processes"]
    restarts = {name: entry["restarts"] for name, entry in processes.items()}
    assert restarts == dict.fromkeys(session.names, 1)
    for name, entry in processes.items():
        assert "SIGKILL" in entry["last_error"], (name, entry)


def test_processes_end_with_a_killed_launcher(start):
    session = start(BOARD)
    pids = session.pids()
    session.wait_for_flow()
    session.process.kill()
    session.process.wait()
    eventually(lambda: not any(alive(pid) for pid in pids.values()), "the end of all processes")


def is_part(pid):
    try:
        return Path(f"/proc/{pid}/comm").read_text().startswith("kav ")
    except OSError:
        return False


def test_ctrl_c_at_once_leaves_nothing(start):
    session = start(BOARD)
    # Its first child is no process of the session, but a system program that looks for libopus.
    eventually(lambda: any(map(is_part, session.children())), "the first process")
    # On a busy machine it may have shown nothing for too long, which is a failure of its own.
    _, report = session.interrupt()
    never = "uplink_video: nothing was displayed"
    assert all(line.startswith(never) for line in report["failures"])
    assert session.errors() == ""
    assert set(report["streams"]) == {"uplink_video"}
    session.assert_nothing_left()


def test_a_session_goes_on_when_another_program_fills_shared_memory(start):
    own = 'mount -t tmpfs -o size=100m none /dev/shm && exec "$@"'
    mounted = ("unshare", "-rm", "sh", "-c", own, "sh")
    if subprocess.run([*mounted, "true"], capture_output=True, check=False).returncode:
        pytest.skip("this machine permits no mount namespace")
    session = start(BOARD, prefix=mounted)
    pids = session.pids()
    session.wait_for_flow()
    memory = Path(f"/proc/{pids['robot']}/root/dev/shm")

    def all_open_their_topics():
        before = {*memory.iterdir()}
        session.wait_for_flow()
        session.wait_for_flow()
        return {*memory.iterdir()} == before

    # A process that opens one later would find no room for it, and begin anew.
    eventually(all_open_their_topics, "the start of all")
    filler = memory / "filler"
    with contextlib.suppress(OSError), filler.open("wb", buffering=0) as file:
        while True:
            file.write(bytes(1 << 20) if shutil.disk_usage(filler).free >= 1 << 20 else bytes(4096))
    assert shutil.disk_usage(filler).free < 4096
    session.wait_for_flow()
    session.wait_for_flow()
    filler.unlink()
    report = session.finish()
    assert restarted(report) == {}

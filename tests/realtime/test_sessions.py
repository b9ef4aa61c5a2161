"""What a killed launcher left is removed; files of running sessions stay."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from kontur_av.topics.session_files import remove_session, session_root, shared_memory
from pipelines.session.sessions import clear_dead_sessions, hold_session, new_session_name


def leave_behind(session):
    """A process that opens topics of `session` and is killed while it does."""
    code = (
        "import os, signal, sys; from kontur_av.topics.bus import TopicBus;"
        "bus = TopicBus(sys.argv[1]); bus.writer('a', max_octets=10);"
        "os.kill(os.getpid(), signal.SIGKILL)"
    )
    subprocess.run([sys.executable, "-c", code, session], check=False, timeout=60)
    session_root(session).mkdir(parents=True, exist_ok=True)
    assert shared_memory(session)


def test_the_process_id_does_not_decide_whether_a_session_lives(monkeypatch):
    """Only what ended sessions left is removed."""
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    with monkeypatch.context() as another_container:
        another_container.setattr(os, "getpid", lambda: ended.pid)
        held = hold_session("lab")
        living = held.__enter__()
    dead = f"lab-{os.getpid()}"
    try:
        leave_behind(living)
        leave_behind(dead)
        (session_root(dead) / "launcher").touch()
        cleared = clear_dead_sessions()
        assert dead in cleared
        assert not session_root(dead).exists() and not shared_memory(dead)
        assert living not in cleared
        assert shared_memory(living) and session_root(living).exists()
    finally:
        held.__exit__(None, None, None)
        remove_session(dead)
    assert not session_root(living).exists() and not shared_memory(living)
    assert dead not in clear_dead_sessions()


def test_two_launchers_of_one_process_id_have_two_sessions():
    with hold_session("x" * 80) as first, hold_session("x" * 80) as second:
        assert first != second
        assert len(second) <= 31
        assert session_root(first).exists()
        assert session_root(second).exists()
    assert not session_root(first).exists()


def test_a_session_lives_as_long_as_one_of_its_processes(monkeypatch):
    held = hold_session("lab")
    session = held.__enter__()
    ready, wait = os.pipe(), os.pipe()
    child = os.fork()
    if child == 0:
        try:
            os.write(ready[1], b"x")
            os.close(wait[1])
            os.read(wait[0], 1)
        finally:
            os._exit(0)
    os.read(ready[0], 1)
    # As if the launcher had been killed: its descriptors are closed, and nothing is removed.
    with monkeypatch.context() as killed:
        killed.setattr("pipelines.session.sessions.remove_session", lambda session: 0)
        held.__exit__(None, None, None)
    assert session not in clear_dead_sessions()
    os.close(wait[1])
    os.waitpid(child, 0)
    assert session in clear_dead_sessions()
    for end in (*ready, wait[0]):
        os.close(end)


@pytest.mark.parametrize("setup", ["spacejustin", "Mein Labor! (2)", "../..", "x" * 80, "ß"])
def test_any_setup_name_makes_a_session_name(setup):
    name = new_session_name(setup)
    assert session_root(name).parent == session_root("any").parent
    assert name.endswith(f"-{os.getpid()}")
    assert len(name) <= 31
    assert shared_memory(name) == []
    assert Path(name).name == name

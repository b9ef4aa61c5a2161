"""What a launcher that was killed has left is cleared away; what belongs to the living stays."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from kontur_av.topics import remove_session, session_root, shared_memory
from pipelines.sessions import clear_dead_sessions, new_session_name


def leave_behind(session):
    """A process that opens topics of `session` and is killed in the middle of it."""
    code = (
        "import os, signal, sys; from kontur_av.topics import TopicBus;"
        "bus = TopicBus(sys.argv[1]); bus.writer('a', max_octets=10);"
        "os.kill(os.getpid(), signal.SIGKILL)"
    )
    subprocess.run([sys.executable, "-c", code, session], check=False, timeout=60)
    session_root(session).mkdir(parents=True, exist_ok=True)
    assert shared_memory(session)


def test_only_what_the_dead_left_is_cleared():
    ended = subprocess.Popen([sys.executable, "-c", ""])
    ended.wait()
    dead, living = f"lab-{ended.pid}", f"lab-{os.getpid()}"
    try:
        for session in (dead, living):
            leave_behind(session)
        cleared = clear_dead_sessions()
        assert dead in cleared
        assert living not in cleared
        assert not session_root(dead).exists()
        assert not shared_memory(dead)
        assert shared_memory(living)
        assert session_root(living).exists()
    finally:
        remove_session(dead)
        remove_session(living)
    assert dead not in clear_dead_sessions()


@pytest.mark.parametrize("setup", ["spacejustin", "Mein Labor! (2)", "../..", "x" * 80, "ß"])
def test_any_setup_name_makes_a_session_name(setup):
    name = new_session_name(setup)
    assert session_root(name).parent == session_root("any").parent
    assert name.endswith(f"-{os.getpid()}")
    assert len(name) <= 31
    assert shared_memory(name) == []
    assert Path(name).name == name

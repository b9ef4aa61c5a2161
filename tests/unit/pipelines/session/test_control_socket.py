"""Asking a running session: how it is chosen, and what happens if it does not answer."""

import json
import shutil
import socket
import tempfile
import threading

import pytest

from kontur_av.errors import ConfigError
from pipelines.session.control import ask, console_path, running_sessions
from pipelines.session.requests import Answer, Request


@pytest.fixture
def console(monkeypatch):
    """console(session, answer): a listening socket; returns the requests that it received."""
    # Not tmp_path, because the path of a socket must be short.
    directory = tempfile.mkdtemp(prefix="kav")
    monkeypatch.setattr(tempfile, "tempdir", directory)
    listeners = []

    def listen(session, answer):
        path = console_path(session)
        path.parent.parent.mkdir(mode=0o700, exist_ok=True)
        path.parent.mkdir()
        listener = socket.socket(socket.AF_UNIX)
        listener.bind(str(path))
        listener.listen()
        listeners.append(listener)
        asked = []

        def run():
            while True:
                try:
                    link, _ = listener.accept()
                except OSError:
                    return
                with link:
                    link.settimeout(5)
                    line = link.makefile("rb").readline()
                    if line:
                        asked.append(json.loads(line))
                        link.sendall(answer)

        threading.Thread(target=run, daemon=True).start()
        return asked

    yield listen
    for listener in listeners:
        listener.shutdown(socket.SHUT_RDWR)
        listener.close()
    shutil.rmtree(directory)


def test_the_only_session_is_asked(console):
    asked = console("one", b'{"ok": true}\n')
    assert ask(Request("static")) == Answer(ok=True)
    assert asked == [{"select": "static"}]


def test_the_setups_name_selects_its_only_session(console):
    asked = console("taskboard-41", b'{"ok": true}\n')
    console("spacejustin-42", b"")
    assert ask(Request("static"), "taskboard") == Answer(ok=True)
    assert asked == [{"select": "static"}]


def test_an_unknown_session_name_is_refused_with_the_running_ones(console):
    console("taskboard-41", b"")
    console("taskboard-42", b"")
    with pytest.raises(ConfigError, match=r"no session lab is running: .*taskboard-42"):
        ask(Request("static"), "lab")
    with pytest.raises(ConfigError, match=r"several .* taskboard-41, taskboard-42 with --session"):
        ask(Request("static"), "taskboard")


def test_with_several_sessions_a_name_is_required(console):
    console("one", b'{"ok": true}\n')
    asked = console("two", b'{"ok": true}\n')
    assert sorted(running_sessions()) == ["one", "two"]
    with pytest.raises(ConfigError, match="--session"):
        ask(Request("static"))
    assert ask(Request("head"), "two") == Answer(ok=True)
    assert asked == [{"select": "head"}]


def test_a_killed_session_is_ignored(console):
    console("one", b'{"ok": true}\n')
    console_path("dead").parent.mkdir(parents=True)
    with socket.socket(socket.AF_UNIX) as dead:
        dead.bind(str(console_path("dead")))
    assert ask(Request("static")).ok


def test_a_slow_answer_is_waited_for(console):
    console("one", b'{"wait_s": 61.5}\n{"ok": true}\n')
    assert ask(Request("static")) == Answer(ok=True)


CUT = (b"", b"garbage\n", b"[1]\n", b'{"ok": tr', b"\xff\xfe\n", b'{"wait_s": 1.5}\n')


@pytest.mark.parametrize("answer", CUT)
def test_a_console_that_dies_during_a_request_is_no_success(console, answer):
    console("one", answer)
    assert not ask(Request("static")).ok

"""Asking a running session: which one, and what if it does not answer."""

import json
import shutil
import socket
import tempfile
import threading

import pytest

from kontur_av.errors import ConfigError
from pipelines.runtime.control import Answer, Request, ask, console_path, running_sessions


@pytest.fixture
def console(monkeypatch):
    """console(session, answer): somebody who listens, and what they were asked."""
    # Not tmp_path: a socket's path has to be short.
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


def test_a_setups_name_will_do_where_one_session_has_it(console):
    asked = console("taskboard-41", b'{"ok": true}\n')
    console("spacejustin-42", b"")
    assert ask(Request("static"), "taskboard") == Answer(ok=True)
    assert asked == [{"select": "static"}]


def test_a_name_that_no_session_has_is_told_with_those_that_run(console):
    console("taskboard-41", b"")
    console("taskboard-42", b"")
    with pytest.raises(ConfigError, match=r"no session lab is running: .*taskboard-42"):
        ask(Request("static"), "lab")
    with pytest.raises(ConfigError, match=r"several .* taskboard-41, taskboard-42 with --session"):
        ask(Request("static"), "taskboard")


def test_of_several_sessions_one_has_to_be_named(console):
    console("one", b'{"ok": true}\n')
    asked = console("two", b'{"ok": true}\n')
    assert sorted(running_sessions()) == ["one", "two"]
    with pytest.raises(ConfigError, match="--session"):
        ask(Request("static"))
    assert ask(Request("head"), "two") == Answer(ok=True)
    assert asked == [{"select": "head"}]


def test_a_session_that_was_killed_is_passed_over(console):
    console("one", b'{"ok": true}\n')
    console_path("dead").parent.mkdir(parents=True)
    with socket.socket(socket.AF_UNIX) as dead:
        dead.bind(str(console_path("dead")))
    assert ask(Request("static")).ok


def test_the_answer_comes_after_the_time_that_it_takes(console):
    console("one", b'{"wait_s": 61.5}\n{"ok": true}\n')
    assert ask(Request("static")) == Answer(ok=True)


CUT = (b"", b"garbage\n", b"[1]\n", b'{"ok": tr', b"\xff\xfe\n", b'{"wait_s": 1.5}\n')


@pytest.mark.parametrize("answer", CUT)
def test_a_console_that_falls_in_the_middle_is_no_success(console, answer):
    console("one", answer)
    assert not ask(Request("static")).ok

"""Asking a process of a running session: how the session is chosen, and what if it is silent."""

import shutil
import socket
import tempfile
import threading

import msgspec
import pytest

from kontur_av.errors import ConfigError
from pipelines.session.sessions import hold_session
from pipelines.session.terminals import ask_desk, desk_path, running_sessions

DESK = "trainer"


class Line(msgspec.Struct):
    text: str = "ask"


@pytest.fixture
def desk(monkeypatch):
    """desk(session, answer): a listening socket; returns the lines that it received."""
    # Not tmp_path, because the path of a socket must be short.
    directory = tempfile.mkdtemp(prefix="kav")
    monkeypatch.setenv("TMPDIR", directory)
    listeners = []

    def listen(session, answer):
        path = desk_path(session, DESK)
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
                        asked.append(line)
                        link.sendall(answer)

        threading.Thread(target=run, daemon=True).start()
        return asked

    yield listen
    for listener in listeners:
        listener.shutdown(socket.SHUT_RDWR)
        listener.close()
    shutil.rmtree(directory)


def ask(session=None):
    return ask_desk(DESK, Line(), Line, session, missing="nobody trains here")


def test_the_only_session_is_asked(desk):
    asked = desk("one", b'{"text": "done"}\n')
    assert ask() == Line("done")
    assert asked == [b'{"text":"ask"}\n']


def test_the_setups_name_selects_its_only_session(desk):
    desk("taskboard-41", b'{"text": "done"}\n')
    desk("spacejustin-42", b"")
    assert ask("taskboard") == Line("done")


def test_an_unknown_session_name_is_refused_with_the_running_ones(desk):
    desk("taskboard-41", b"")
    desk("taskboard-42", b"")
    with pytest.raises(ConfigError, match=r"no session lab is running: .*taskboard-42"):
        ask("lab")
    with pytest.raises(ConfigError, match=r"several .* taskboard-41, taskboard-42 with --session"):
        ask("taskboard")


def test_with_several_sessions_a_name_is_required(desk):
    desk("one", b'{"text": "first"}\n')
    desk("two", b'{"text": "second"}\n')
    assert sorted(running_sessions(DESK)) == ["one", "two"]
    with pytest.raises(ConfigError, match="--session"):
        ask()
    assert ask("two") == Line("second")


def test_without_a_session_the_mend_is_named(desk):
    desk("one", b'{"text": "done"}\n')
    with pytest.raises(ConfigError, match="nobody"):
        ask_desk("owner", Line(), Line, None, missing="nobody has an owner")


@pytest.mark.parametrize("kind", [socket.SOCK_STREAM, socket.SOCK_DGRAM])
def test_a_killed_session_is_ignored(desk, kind):
    desk("one", b'{"text": "done"}\n')
    desk_path("dead", DESK).parent.mkdir(parents=True)
    with socket.socket(socket.AF_UNIX, kind) as dead:
        dead.bind(str(desk_path("dead", DESK)))
    assert running_sessions(DESK) == ["one"]
    assert ask() == Line("done")


def test_a_process_that_is_restarted_is_waited_for(desk):
    desk("other", b"")
    with hold_session("lab") as session:
        path = desk_path(session, DESK)
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as killed:
            killed.bind(str(path))
        with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as again:

            def restart():
                path.unlink()
                again.bind(str(path))
                again.listen()

            restarting = threading.Timer(0.2, restart)
            restarting.start()
            assert session in running_sessions(DESK)
            restarting.join()


def test_sockets_of_datagrams_are_found(desk):
    desk("one", b'{"text": "done"}\n')
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as link:
        link.bind(str(desk_path("one", "tmtc.space")))
        assert running_sessions("tmtc.space") == ["one"]


def test_a_process_that_dies_during_a_request_answers_nothing(desk):
    desk("one", b"")
    assert ask() is None

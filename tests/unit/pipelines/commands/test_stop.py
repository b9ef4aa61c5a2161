"""`kontur-av stop` stops every session, whatever else fails."""

import errno
import os
from contextlib import ExitStack
from unittest.mock import MagicMock

import pytest

from pipelines.cli import main
from pipelines.commands import common, stop, tc
from pipelines.hand import safety_ends
from pipelines.mission.tmtc_socket import tmtc_socket_name
from pipelines.session.kept_files import KeptOrders
from pipelines.session.requests import request_socket
from pipelines.session.sessions import hold_session
from pipelines.session.setup.segments import Segment
from telepresence.tmtc.pus.dictionary_file import built_in_dictionary


@pytest.fixture
def silent():
    """[why the robots do not answer; "" if they do]."""
    return [""]


@pytest.fixture
def held(tmp_path, monkeypatch, silent):
    """held("lab", ...): the names of sessions that run, and were not started here."""
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(common, "started_here", lambda session: False)
    monkeypatch.setattr(safety_ends, "await_stopped", lambda session, ordered_ns, **_: silent[0])
    with ExitStack() as stack:

        def hold(*setups):
            found = [stack.enter_context(hold_session(setup)) for setup in setups]
            for module in (stop, common):
                monkeypatch.setattr(module, "launched_sessions", lambda: found)
            return found

        yield hold


def stopped(*sessions):
    return [KeptOrders(session).stopped for session in sessions]


def test_without_a_name_it_stops_all_and_its_release_asks(held, silent, capsys):
    lab, pool = held("lab", "pool")
    silent[0] = "the robot has not answered for 1.0 s"
    assert main(["stop"]) == 1
    assert f"{pool}: the robot has not answered for 1.0 s" in capsys.readouterr().err
    silent[0] = ""
    assert main(["stop"]) == 0
    assert stopped(lab, pool) == [True, True]
    assert main(["stop", "--release"]) == 2
    assert "several sessions" in capsys.readouterr().err
    assert main(["stop", "--release", "--session", "pool"]) == 0
    assert stopped(lab, pool) == [True, False]


def test_a_release_across_the_radio_asks_the_robot_and_one_here_waits_for_it(
    held, silent, capsys, monkeypatch
):
    (lab,) = held("lab")
    asked = []
    monkeypatch.setattr(tc, "run", lambda args: asked.append((args.application, args.words)) or 1)
    assert main(["stop"]) == 0
    silent[0] = "the joystick's end orders the stop, too: release it there"
    assert main(["stop", "--release"]) == 1 and not asked
    out, error = capsys.readouterr()
    assert f"{lab}: {silent[0]}" in error and "released" not in out
    # The other end, which the robot is at, may have ordered it.
    request_socket(lab, tmtc_socket_name(Segment.SPACE)).touch()
    assert main(["stop", "--release"]) == 1
    assert asked == [("robot", ["release_stop"])]
    request_socket(lab, tmtc_socket_name(Segment.GROUND)).touch()
    assert main(["stop", "--release"]) == 0 and "no emergency stop" in capsys.readouterr().out


def test_a_telecommand_goes_from_its_own_end_where_the_other_one_is_elsewhere(held, monkeypatch):
    (lab,) = held("lab")
    sent = []

    def running(*names):
        return [lab] if tmtc_socket_name(Segment.GROUND) in names else []

    for module in (tc, common):
        monkeypatch.setattr(module, "running_sessions", running)
    monkeypatch.setattr(tc, "read_dictionary", lambda _session: built_in_dictionary())
    monkeypatch.setattr(tc.TopicBus, "join", MagicMock())
    monkeypatch.setattr(tc, "follow", lambda sending, _: sent.append(sending._origin) or 0)
    assert main(["tc", "robot", "power_on"]) == 0 and sent == [Segment.GROUND]
    assert main(["tc", "robot", "power_on", "--from", "space"]) == 2


def test_it_finds_its_session_on_a_full_disk_and_holds_for_a_user_without_a_name(held, monkeypatch):
    def full():
        raise FileNotFoundError("no usable temporary directory")

    (lab,) = held("lab")
    monkeypatch.setattr("tempfile.gettempdir", full)
    asked = os.access  # read-only by now
    monkeypatch.setattr(os, "access", lambda p, mode: not mode & os.W_OK and asked(p, mode))
    assert stopped(lab) == [False]
    assert main(["stop"]) == 0
    assert stopped(lab) == [True]

    # It holds for a user without a name.
    def unknown(uid):
        raise KeyError(uid)

    monkeypatch.setattr("pwd.getpwuid", unknown)
    KeptOrders(lab).release()
    assert main(["stop"]) == 0
    assert KeptOrders(lab).stopped_by == f"a terminal of {os.getuid()}"


def test_if_it_fails_for_one_session_it_stops_the_others(held, monkeypatch, capsys):
    lab, sea = held("lab", "sea")
    first, real = KeptOrders(lab), KeptOrders.stop

    def stop_one(orders, by):
        if orders is first:
            raise OSError(errno.EROFS, "Read-only file system")
        real(orders, by)

    monkeypatch.setattr(stop, "KeptOrders", lambda name: first if name == lab else KeptOrders(name))
    monkeypatch.setattr(KeptOrders, "stop", stop_one)
    assert main(["stop"]) == 1
    assert stopped(lab, sea) == [False, True]
    out, error = capsys.readouterr()
    assert out.startswith(f"{sea}: emergency stop by ") and "make the file system writable" in error


def test_without_a_directory_for_its_files_no_session_is_asked(monkeypatch, capsys):
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    assert main(["stop"]) == 2
    said = capsys.readouterr().err
    assert said == "kontur-av: no directory for temporary files: set TMPDIR to one of your own\n"

"""Which session a command acts on, and when it asks."""

import errno
import os

import pytest

from kontur_av.errors import ConfigError
from pipelines.cli import main
from pipelines.commands import common, stop
from pipelines.commands.common import acting_on
from pipelines.session.kept_files import KeptOrders
from pipelines.session.sessions import hold_session, started_here


@pytest.fixture
def runs(monkeypatch):
    """runs(*others, here=(...)): these sessions run, of which some were started here."""

    def set_up(*everywhere, here=()):
        monkeypatch.setattr(common, "sessions", lambda: list(everywhere))
        monkeypatch.setattr(common, "started_here", lambda session: session in here)

    return set_up


def test_the_session_is_named_on_standard_error(runs, capsys):
    runs("lab-1")
    assert acting_on(None, ["lab-1"], moves=True) == "lab-1"
    assert capsys.readouterr().err == "session lab-1\n"


def test_of_several_the_one_of_this_terminal_is_meant(runs):
    runs("lab-1", "lab-2", here=["lab-2"])
    assert acting_on(None, ["lab-1", "lab-2"], moves=True) == "lab-2"
    assert acting_on("lab-1", ["lab-1", "lab-2"], moves=True) == "lab-1"
    runs("lab-1", "lab-2", here=["lab-1", "lab-2"])
    with pytest.raises(ConfigError, match="several sessions"):
        acting_on(None, ["lab-1", "lab-2"])


def test_what_moves_a_robot_asks_beside_another_session(runs):
    runs("lab-1", "pool-2")
    # Only one has what the command needs, which is no reason to take it for the meant one.
    assert acting_on(None, ["lab-1"]) == "lab-1"
    with pytest.raises(ConfigError, match="pool-2 runs, too: name it with --session lab-1"):
        acting_on(None, ["lab-1"], moves=True)
    assert acting_on("lab", ["lab-1"], moves=True) == "lab-1"
    with pytest.raises(ConfigError, match="no session"):
        acting_on(None, [], moves=True)


def test_a_session_knows_its_terminal(tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    with hold_session("lab") as session:
        assert started_here(session)
        monkeypatch.setattr(os, "getsid", lambda _: 1)
        assert not started_here(session)
    assert not started_here(session)


def test_an_emergency_stop_without_a_name_stops_all_and_its_release_asks(
    tmp_path, monkeypatch, capsys
):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    with hold_session("lab") as lab, hold_session("pool") as pool:
        for module in (stop, common):
            monkeypatch.setattr(module, "sessions", lambda: [lab, pool])
        monkeypatch.setattr(common, "started_here", lambda session: False)
        assert main(["stop"]) == 0
        assert [KeptOrders(one).stopped for one in (lab, pool)] == [True, True]
        assert main(["stop", "--release"]) == 2
        assert main(["stop", "--release", "--session", "pool"]) == 0
        assert [KeptOrders(one).stopped for one in (lab, pool)] == [True, False]
    assert "several sessions" in capsys.readouterr().err


def test_an_emergency_stop_by_a_user_without_a_name_holds(tmp_path, monkeypatch):
    def unknown(uid):
        raise KeyError(uid)

    monkeypatch.setenv("TMPDIR", str(tmp_path))
    with hold_session("lab") as lab:
        monkeypatch.setattr(stop, "sessions", lambda: [lab])
        monkeypatch.setattr("pwd.getpwuid", unknown)
        assert main(["stop"]) == 0
        assert KeptOrders(lab).stopped_by == f"a terminal of {os.getuid()}"


def test_an_emergency_stop_finds_its_session_on_a_full_disk(tmp_path, monkeypatch):
    def full():
        raise FileNotFoundError("no usable temporary directory")

    monkeypatch.setenv("TMPDIR", str(tmp_path))
    with hold_session("lab") as lab:
        monkeypatch.setattr("tempfile.gettempdir", full)
        asked = os.access  # read-only by now
        monkeypatch.setattr(os, "access", lambda p, mode: not mode & os.W_OK and asked(p, mode))
        for module in (stop, common):
            monkeypatch.setattr(module, "sessions", lambda: [lab])
        assert not KeptOrders(lab).stopped
        assert main(["stop"]) == 0
        assert KeptOrders(lab).stopped


def test_an_emergency_stop_that_fails_for_one_session_stops_the_others(
    tmp_path, monkeypatch, capsys
):
    real = KeptOrders.stop

    def stop_one(orders, by):
        if orders is first:
            raise OSError(errno.EROFS, "Read-only file system")
        real(orders, by)

    monkeypatch.setenv("TMPDIR", str(tmp_path))
    with hold_session("lab") as lab, hold_session("sea") as sea:
        first = KeptOrders(lab)
        monkeypatch.setattr(
            stop, "KeptOrders", lambda name: {lab: first}.get(name, KeptOrders(name))
        )
        monkeypatch.setattr(KeptOrders, "stop", stop_one)
        monkeypatch.setattr(stop, "sessions", lambda: [lab, sea])
        assert main(["stop"]) == 1
        assert KeptOrders(sea).stopped and not KeptOrders(lab).stopped
    out, error = capsys.readouterr()
    assert out.startswith(f"{sea}: emergency stop by ") and "make the file system writable" in error


def test_without_a_directory_for_its_files_no_session_is_asked(monkeypatch, capsys):
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    assert main(["stop"]) == 2
    said = capsys.readouterr().err
    assert said == "kontur-av: no directory for temporary files: set TMPDIR to one of your own\n"


@pytest.mark.parametrize("name", ["a\nb", "a\x1b[31m", "a\u2028b", "a\r"])
def test_what_was_written_wrong_stands_in_one_line(name, capsys):
    assert main(["topology", "--setup", f"{name}.toml"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line.isprintable() and line.startswith("kontur-av: cannot read setup a\\")

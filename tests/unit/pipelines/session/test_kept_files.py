"""Orders that outlive the processes that took them, and what a session and `maintain` tell."""

import errno
import re
import shutil
from pathlib import Path
from types import SimpleNamespace

import msgspec
import pytest

from kontur_av.topics import session_files
from kontur_av.topics.session_files import make_session_root, session_root
from pipelines.hand.safety_ends import FollowedStop
from pipelines.session import kept_files
from pipelines.session.session_metrics import Event

SESSION = "lab-1"


class Orders(msgspec.Struct):
    on: bool


def full(*_, **__):
    raise OSError(errno.ENOSPC, "No space left on device")


@pytest.fixture
def kept(tmp_path, monkeypatch):
    monkeypatch.setattr(session_files, "user_root", lambda: tmp_path)
    make_session_root(SESSION)
    return kept_files.KeptOrders(SESSION)


@pytest.mark.rule("S6")
@pytest.mark.parametrize(
    ("disk", "by"), [((), "a test"), (["write_bytes"], ""), (["write_bytes", "touch"], "")]
)
def test_an_emergency_stop_holds_until_it_is_released_also_on_a_full_disk(
    kept, monkeypatch, disk, by
):
    if "touch" in disk:
        # Without room for a file it takes one that is there.
        session_files.partial_of(session_root(SESSION) / "stop").touch()
    for what in disk:
        monkeypatch.setattr(Path, what, full)
    assert not kept.stopped
    kept.stop("a test")
    assert (kept.stopped, kept.stopped_by) == (True, by)
    kept.release()
    assert not kept.stopped


@pytest.mark.rule("S6")
def test_a_stop_needs_no_room_where_its_file_was_made_ready(kept, monkeypatch):
    kept_files.arm_stop(SESSION)
    for what in ("write_bytes", "touch", "replace", "open"):
        monkeypatch.setattr(Path, what, full)
    kept.stop("a test")
    assert (kept.stopped, kept.stopped_by) == (True, "")
    kept.release()
    monkeypatch.undo()
    # Armed again by its release.
    monkeypatch.setattr(session_files, "user_root", lambda: session_root(SESSION).parent)
    kept.stop("a test")
    kept.stop("another test")
    assert kept.stopped_by == "a test"


def test_two_processes_that_replace_one_file_at_once_do_not_disturb_each_other(kept, monkeypatch):
    path, write = session_root(SESSION) / "dictionary.json", Path.write_bytes

    def while_another_writes(partial, content):
        write(partial, content)
        monkeypatch.setattr(Path, "write_bytes", write)
        monkeypatch.setattr("os.getpid", lambda: 1)
        session_files.replace_file(path, b"other")

    monkeypatch.setattr(Path, "write_bytes", while_another_writes)
    session_files.replace_file(path, b"one")
    assert path.read_bytes() == b"one"


def test_orders_without_room_are_unknown_and_older_ones_do_not_come_back(kept, monkeypatch):
    first, unknown = Orders(on=True), Orders(on=False)
    kept.keep("robot", Orders(on=True))
    memory = session_root(SESSION) / "owner"
    session_files.remember(memory, b"partner")
    monkeypatch.setattr(Path, "replace", full)
    kept.keep("robot", Orders(on=False))
    assert kept.recall("robot", first, unknown) is unknown
    session_files.remember(memory, b"iss")
    assert memory.read_bytes() == b""
    # Not even that: the process goes on.
    monkeypatch.setattr(Path, "write_bytes", full)
    kept.keep("robot", Orders(on=True))
    session_files.remember(memory, b"iss")


def test_a_stop_that_cannot_be_kept_holds_the_robot_and_is_tried_again(kept, monkeypatch):
    envelope = SimpleNamespace(stopped=True, stopped_by="a telecommand")
    follow = FollowedStop(kept, envelope).follow
    with monkeypatch.context() as disk:
        disk.setattr(kept, "stop", full)
        for now_ns in range(3):
            follow(now_ns)
    assert envelope.stopped and not kept.stopped
    follow(3)
    assert kept.stopped

    # Without its directory a session counts as stopped.
    kept.release()
    assert not kept.stopped
    shutil.rmtree(session_root(SESSION))
    assert kept.stopped
    session_root(SESSION).touch()
    assert kept.stopped


@pytest.mark.rule("S6")
def test_a_stop_belongs_to_the_robot_and_outlives_its_session_until_it_is_released(
    kept, tmp_path, monkeypatch
):
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))

    def started(setup="lab", robot="udp:arm"):
        """A new session in the place of the one before: what it says, and its orders."""
        shutil.rmtree(session_root(SESSION))
        make_session_root(SESSION)
        kept_files.arm_stop(SESSION)
        said = kept_files.keep_latch(SESSION, setup, robot)
        return said, kept_files.KeptOrders(SESSION)

    said, orders = started()
    assert not said and not orders.stopped and not orders.settle()
    # Its file was made ready.
    with monkeypatch.context() as disk:
        disk.setattr(Path, "write_bytes", full)
        disk.setattr(Path, "touch", full)
        orders.stop("a test")
    for _ in range(2):
        said, orders = started()
        assert re.match(r"the emergency stop by a test of 2\d{3}-.* UTC holds the robot:", said)
        assert orders.stopped and orders.stopped_by == "a test"
    assert [started(*other)[0] for other in (("sea",), ("lab", "udp:other"))] == ["", ""]
    _, orders = started()
    # Another session with this robot was released.
    (latch,) = (tmp_path / "state" / "kontur-av" / "stops").glob("lab-*[!d]")
    latch.unlink()
    assert not orders.settle() and latch.exists()
    orders.release()
    assert started()[0] == ""

    # Without a place for it a stop holds in its session, which says so.
    (tmp_path / "file").touch()
    for name in ("STATE_DIRECTORY", "XDG_STATE_HOME"):
        monkeypatch.setenv(name, str(tmp_path / "file"))
        said, orders = started()
        assert "ends with this session" in said and "set XDG_STATE_HOME" in said
        orders.stop("a test")
        assert orders.stopped and "ends with this session" in orders.settle()
        orders.release()
        assert not orders.stopped
    # What cannot be looked for holds.
    denied = PermissionError(errno.EACCES, "Permission denied")
    monkeypatch.setattr(Path, "lstat", lambda path: (_ for _ in ()).throw(denied))
    assert "holds the robot" in started()[0]


@pytest.mark.usefixtures("kept")
def test_each_note_comes_once_and_malformed_ones_are_left_out():
    reader, notes = kept_files.NotesReader(SESSION), session_root(SESSION) / "notes"
    assert reader.read() == []
    kept_files.add_note(SESSION, kept_files.Note("milestone", "x" * 500))
    assert reader.read() == [kept_files.Note("milestone", "x" * 200)]
    with notes.open("ab") as file:
        file.write(b'{"what": "session", "text": "no kind of a note"}\n')
        file.write(b'{"what": "upkeep", "text": "\xff"}\n{"what": "upkeep", ')
    assert reader.read() == []
    with notes.open("ab") as file:
        file.write(b'"text": "whole now"}\n')
    assert reader.read() == [kept_files.Note("upkeep", "whole now")]
    with pytest.raises(OSError):
        kept_files.add_note("none", kept_files.Note("upkeep", "nobody is there"))

    assert kept_files.read_now(SESSION) is None
    event = Event(number=3, at_us=1, what="upkeep", text="loss of signal in 60 s")
    now = kept_files.SessionNow(experiment="aiming, run 1", events=[event])
    kept_files.write_now(SESSION, now)
    assert kept_files.read_now(SESSION) == now

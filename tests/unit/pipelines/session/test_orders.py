"""Orders that outlive the processes that took them."""

import errno
from pathlib import Path
from types import SimpleNamespace

import msgspec
import pytest

from kontur_av.topics import session_files
from kontur_av.topics.session_files import make_session_root, session_root
from pipelines.hand.safety_ends import follow_stop
from pipelines.session.kept_files import KeptOrders


class Orders(msgspec.Struct):
    on: bool


def full(*_, **__):
    raise OSError(errno.ENOSPC, "No space left on device")


@pytest.fixture
def kept(tmp_path, monkeypatch):
    monkeypatch.setattr(session_files, "user_root", lambda: tmp_path)
    make_session_root("lab-1")
    return KeptOrders("lab-1")


def test_an_emergency_stop_holds_until_it_is_released(kept):
    assert not kept.stopped
    kept.stop("a test")
    assert kept.stopped
    assert kept.stopped_by == "a test"
    kept.release()
    assert not kept.stopped


def test_an_emergency_stop_holds_on_a_full_disk(kept, monkeypatch):
    monkeypatch.setattr(Path, "write_bytes", full)
    kept.stop("a test")
    assert kept.stopped
    assert kept.stopped_by == ""
    kept.release()
    assert not kept.stopped


def test_orders_without_room_are_unknown_and_older_ones_do_not_come_back(kept, monkeypatch):
    first, unknown = Orders(on=True), Orders(on=False)
    kept.keep("robot", Orders(on=True))
    memory = session_root("lab-1") / "owner"
    session_files.remember(memory, b"partner")
    monkeypatch.setattr(Path, "replace", full)
    kept.keep("robot", Orders(on=False))
    assert kept.recall("robot", first, unknown) is unknown
    session_files.remember(memory, b"iss")
    assert memory.read_bytes() == b""
    # Not even that: the process goes on.
    monkeypatch.setattr(Path, "write_bytes", full)
    kept.keep("robot", Orders(on=False))
    session_files.remember(memory, b"iss")


def test_an_emergency_stop_without_room_for_a_file_takes_what_is_there(kept, monkeypatch):
    (session_root("lab-1") / "stop.new").touch()
    for what in ("write_bytes", "touch"):
        monkeypatch.setattr(Path, what, full)
    kept.stop("a test")
    assert kept.stopped


def test_a_stop_that_cannot_be_kept_holds_the_robot_and_is_tried_again(kept, monkeypatch):
    envelope = SimpleNamespace(stopped=True)
    follow = follow_stop(kept, SimpleNamespace(envelope=envelope))
    with monkeypatch.context() as disk:
        disk.setattr(kept, "stop", full)
        for now_ns in range(3):
            follow(now_ns)
    assert envelope.stopped and not kept.stopped
    follow(3)
    assert kept.stopped


@pytest.mark.parametrize("left", ["nothing", "file"])
def test_without_its_directory_a_session_counts_as_stopped(kept, left):
    root = session_root("lab-1")
    root.rmdir()
    if left == "file":
        root.touch()
    assert kept.stopped

"""Orders that outlive the processes that took them."""

import errno
from pathlib import Path

import msgspec
import pytest

from kontur_av.topics import session_files
from kontur_av.topics.session_files import make_session_root, session_root
from pipelines.session.kept_files import KeptOrders


class Orders(msgspec.Struct):
    on: bool


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
    def full(path, content):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    kept.stop("a test")
    assert kept.stopped
    assert kept.stopped_by == ""
    kept.release()
    assert not kept.stopped


def test_orders_without_room_are_unknown_and_older_ones_do_not_come_back(kept, monkeypatch):
    def full(path, new):
        raise OSError(errno.ENOSPC, "No space left on device")

    first, unknown = Orders(on=True), Orders(on=False)
    kept.keep("robot", Orders(on=True))
    memory = session_root("lab-1") / "owner"
    session_files.remember(memory, b"partner")
    monkeypatch.setattr(Path, "replace", full)
    kept.keep("robot", Orders(on=False))
    assert kept.recall("robot", first, unknown) is unknown
    for _ in range(2):
        session_files.remember(memory, b"iss")
        assert not memory.exists()


@pytest.mark.parametrize("left", ["nothing", "file"])
def test_without_its_directory_a_session_counts_as_stopped(kept, left):
    root = session_root("lab-1")
    root.rmdir()
    if left == "file":
        root.touch()
    assert kept.stopped

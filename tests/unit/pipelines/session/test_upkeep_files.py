"""A session and `kontur-av maintain` read what the other wrote, once and whole."""

import pytest

from kontur_av.topics import session_files
from pipelines.session.figures import Event
from pipelines.session.kept_files import (
    Note,
    NotesReader,
    SessionNow,
    add_note,
    read_now,
    write_now,
)


@pytest.fixture
def session(tmp_path, monkeypatch):
    monkeypatch.setattr(session_files, "user_root", lambda: tmp_path)
    (tmp_path / "one").mkdir()
    return "one"


def test_what_a_session_tells_is_read(session):
    assert read_now(session) is None
    event = Event(number=3, at_us=1, what="upkeep", text="loss of signal in 60 s")
    now = SessionNow(experiment="aiming, run 1", events=[event])
    write_now(session, now)
    assert read_now(session) == now


def test_each_note_comes_once_and_malformed_ones_are_left_out(session, tmp_path):
    reader, notes = NotesReader(session), tmp_path / "one" / "notes"
    assert reader.read() == []
    add_note(session, Note("milestone", "x" * 500))
    assert reader.read() == [Note("milestone", "x" * 200)]
    with notes.open("ab") as file:
        file.write(b'{"what": "session", "text": "no kind of a note"}\n')
        file.write(b'{"what": "upkeep", "text": "\xff"}\n{"what": "upkeep", ')
    assert reader.read() == []
    with notes.open("ab") as file:
        file.write(b'"text": "whole now"}\n')
    assert reader.read() == [Note("upkeep", "whole now")]
    with pytest.raises(OSError):
        add_note("none", Note("upkeep", "nobody is there"))

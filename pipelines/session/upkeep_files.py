"""What a session and `kontur-av maintain` tell each other, as files of the session's directory.

| file | written by | what |
|---|---|---|
| `now.json` | the session, once a second | `SessionNow` |
| `notes` | `maintain` | a `Note` a line |
"""

import os
from typing import Final, Literal

import msgspec

from kontur_av.topics.session_files import session_root
from pipelines.session.figures import Event
from pipelines.session.reception import replace_file
from telepresence.malformed import MALFORMED

_NOW: Final = "now.json"
_NOTES: Final = "notes"
_MOST_CHARACTERS: Final = 200
#: Octets of the notes to read at a time.
_READ_OCTETS: Final = 16 << 10


class SessionNow(msgspec.Struct, frozen=True, kw_only=True):
    """experiment: what runs, in words; "" if nothing does. events: the newest announcements."""

    experiment: str
    events: list[Event]


class Note(msgspec.Struct, frozen=True):
    """A milestone, or what maintenance did."""

    what: Literal["milestone", "upkeep"]
    text: str


def write_now(session: str, now: SessionNow) -> None:
    replace_file(session_root(session) / _NOW, msgspec.json.encode(now))


def read_now(session: str) -> SessionNow | None:
    """Return the newest state that a session has told; None before the first."""
    try:
        return msgspec.json.decode((session_root(session) / _NOW).read_bytes(), type=SessionNow)
    except (OSError, *MALFORMED):
        return None


def add_note(session: str, note: Note) -> None:
    """Add a note to the events of a session. OSError if it has ended."""
    text = msgspec.structs.replace(note, text=note.text[:_MOST_CHARACTERS])
    path = session_root(session) / _NOTES
    descriptor = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        os.write(descriptor, msgspec.json.encode(text) + b"\n")
    finally:
        os.close(descriptor)


class NotesReader:
    """Reads each note of a session once."""

    def __init__(self, session: str) -> None:
        self._path = session_root(session) / _NOTES
        self._at = 0

    def read(self) -> list[Note]:
        """Return the notes since the last call; malformed lines are left out."""
        try:
            with self._path.open("rb") as file:
                file.seek(self._at)
                octets = file.read(_READ_OCTETS)
        except OSError:
            return []
        whole = octets[: octets.rfind(b"\n") + 1]
        self._at += len(whole)
        found = []
        for line in whole.splitlines():
            try:
                found.append(msgspec.json.decode(line, type=Note))
            except MALFORMED:
                continue
        return found

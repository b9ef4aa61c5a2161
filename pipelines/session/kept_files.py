"""What processes of a session, and `kontur-av maintain`, leave each other in its directory.

| file | written by | what |
|---|---|---|
| `stop` | any process that stops the robot | who ordered the stop; none without it |
| `stop.armed` | the launcher | renamed to `stop`, which needs no room on a disk |
| `latch` | the launcher | a link to such a `stop` of the robot, which outlives the session |
| `orders-robot`, `orders-joystick` | those processes | their newest orders, as JSON |
| `now.json` | the session, once a second | `SessionNow` |
| `notes` | `maintain` | a `Note` a line |

A process that starts goes on with its orders. If the directory is gone, or a file has other
content, it does not know what was ordered; then it starts halted and off.
"""

import errno
import hashlib
import os
import re
import time
from contextlib import suppress
from pathlib import Path
from typing import Final, Literal, TypeVar

import msgspec

from kontur_av.clock import NS_PER_S
from kontur_av.topics.session_files import partial_of, replace_file, session_root
from pipelines.session.session_metrics import Event
from telepresence.malformed import MALFORMED

T = TypeVar("T", bound=msgspec.Struct)
#: Of the words that say who stopped it.
_MOST_CHARACTERS = 120
_STOP, _LATCH = "stop", "latch"


class StopFile:
    """A stop that holds while its file is there. Once armed it needs no room on a disk."""

    def __init__(self, path: Path) -> None:
        self.path, self.armed = path, path.with_name(f"{path.name}.armed")

    def arm(self) -> None:
        """Have a file ready that only needs another name to be a stop."""
        if not self.path.exists():
            self.armed.write_bytes(b" " * _MOST_CHARACTERS)

    @property
    def there(self) -> bool:
        """Whether it holds; also if that cannot be told."""
        try:
            self.path.lstat()
        except OSError as error:
            return error.errno not in (errno.ENOENT, errno.ENOTDIR)
        return True

    @property
    def by(self) -> str:
        """Who ordered it, in words; "" if nobody did, or that is not known."""
        try:
            return self.path.read_text("utf-8", errors="replace")[:_MOST_CHARACTERS].strip()
        except OSError:
            return ""

    @property
    def at_ns(self) -> int:
        """When it was ordered, on the clock of files; 0 if that is not known."""
        try:
            return self.path.stat().st_mtime_ns
        except OSError:
            return 0

    def order(self, by: str) -> None:
        words = by.encode()[:_MOST_CHARACTERS]
        # Before the file is the stop: its instant names the order. Without room nobody is named.
        with suppress(OSError), self.armed.open("r+b") as file:
            file.write(words.ljust(_MOST_CHARACTERS))
        with suppress(OSError):
            self.armed.rename(self.path)
        if self.path.exists():
            return
        try:
            replace_file(self.path, words)
        except OSError:
            # A full disk has no room for the words. The file begun for them can be renamed.
            with suppress(OSError):
                partial_of(self.path).replace(self.path)
                return
            self.path.touch()

    def release(self, by: str = "") -> None:
        # The released file tells who did so.
        with suppress(OSError), self.path.open("r+b") as file:
            file.write(by.encode()[:_MOST_CHARACTERS].ljust(_MOST_CHARACTERS))
        try:
            self.path.rename(self.armed)
        except OSError:
            self.path.unlink(missing_ok=True)


def arm_stop(session: str) -> None:
    """Have a session's stop need no room on a disk."""
    StopFile(session_root(session) / _STOP).arm()


def _latch_path(setup: str, robot: str) -> Path:
    """Where the stop of a robot is kept; RuntimeError for a user without a home directory."""
    room = Path(os.environ.get("STATE_DIRECTORY", "").partition(":")[0])
    if not room.is_absolute():
        state = Path(os.environ.get("XDG_STATE_HOME", ""))
        # The XDG specification: a relative path is to be ignored.
        room = state if state.is_absolute() else Path.home() / ".local" / "state"
        room /= "kontur-av"
    digest = hashlib.sha256(robot.encode()).hexdigest()[:8]
    return room / "stops" / f"{re.sub('[^A-Za-z0-9]+', '-', setup)[:40]}-{digest}"


def keep_latch(session: str, setup: str, robot: str) -> str:
    """Have the stops of a new session outlive it; begin stopped if one holds.

    setup, robot: the names of the site and of the robot, which a stop belongs to. Return a line to
    print; "" if there is nothing to say. OSError if it cannot begin stopped.
    """
    try:
        latch = StopFile(_latch_path(setup, robot))
    except RuntimeError as error:
        return _forgotten(error)
    problem = ""
    try:
        (session_root(session) / _LATCH).symlink_to(latch.path)
        latch.path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        latch.arm()
    except OSError as error:
        problem = _forgotten(error)
    if not latch.there:
        return problem
    KeptOrders(session).stop(latch.by)
    return f"{stopped_words(latch)} holds the robot: `kontur-av stop --release` ends it"


def _forgotten(error: Exception) -> str:
    return f"an emergency stop ends with this session ({error}): set XDG_STATE_HOME"


def stopped_words(stop: StopFile) -> str:
    """Who ordered a stop, and when."""
    at_s = stop.at_ns / NS_PER_S
    at = f" of {time.strftime('%Y-%m-%d %H:%M:%S UTC', time.gmtime(at_s))}" if at_s else ""
    return f"the emergency stop by {stop.by or 'somebody'}{at}"


class KeptOrders:
    """The orders of one session, for one process."""

    def __init__(self, session: str) -> None:
        self._root = session_root(session)
        self._here = StopFile(self._root / _STOP)
        #: Outlives the session; None: nothing of it does.
        self._latch: StopFile | None = None
        with suppress(OSError):
            self._latch = StopFile((self._root / _LATCH).readlink())
        self._last: dict[str, msgspec.Struct] = {}
        # As text, because loops look a hundred times a second, and a `Path` takes twice as long.
        # The second is there only if the first can be looked for.
        self._paths = os.fspath(self._here.path), f"{self._root}/."

    @property
    def stopped(self) -> bool:
        """Whether an emergency stop holds; also if nothing is known of the session."""
        stop, root = self._paths
        # Unlike lstat(2), this raises nothing for the usual case, which takes half as long.
        return os.access(stop, os.F_OK) or not os.access(root, os.F_OK)

    @property
    def stopped_by(self) -> str:
        """Who ordered it, in words; "" if nobody did, or that is not known."""
        return self._here.by

    @property
    def stopped_at_ns(self) -> int:
        """When it was ordered last, on the clock of files; 0 if that is not known."""
        return self._here.at_ns

    def stop(self, by: str) -> None:
        """Order an emergency stop, also anew. Who ordered the first of several is kept."""
        if self.stopped:
            with suppress(OSError):
                os.utime(self._here.path)
        else:
            self._here.order(by)
        # After what acts. The launcher tries it again, and says if it cannot be kept.
        self.settle()

    @property
    def released_by(self) -> str:
        """Who released the last stop, in words; "" if that is not known."""
        return StopFile(self._here.armed).by

    def release(self, by: str = "") -> None:
        self._here.release(by)
        with suppress(OSError):
            if self._latch is not None:
                self._latch.release()

    def settle(self, *, wait: bool = False) -> str:
        """Have a stop outlive the session; return why it does not, or "".

        wait: until a loss of power leaves it, too.
        """
        try:
            if self._latch is not None and self.stopped:
                if not self._latch.there:
                    self._latch.order(self.stopped_by)
                if wait:
                    with self._latch.path.open("rb") as file:
                        os.fsync(file.fileno())
        except OSError as error:
            return _forgotten(error)
        return ""

    def recall(self, name: str, first: T, unknown: T) -> T:
        """Return the orders of process `name`.

        first: if there were none yet. unknown: if that cannot be told.
        """
        try:
            return msgspec.json.decode(self._path(name).read_bytes(), type=type(first))
        except FileNotFoundError:
            return first if self._root.is_dir() else unknown
        except (OSError, *MALFORMED):
            return unknown

    def keep(self, name: str, orders: msgspec.Struct) -> None:
        """Keep the orders of process `name`, if they differ from the last ones.

        Call it at the start, too: once the disk is full, a file that exists can still be emptied.
        """
        if orders == self._last.get(name):
            return
        self._last[name] = orders
        path = self._path(name)
        try:
            replace_file(path, msgspec.json.encode(orders))
        except OSError:
            # On a full disk: after a restart nothing is known, so older orders do not come back.
            with suppress(OSError):
                path.write_bytes(b"")

    def _path(self, name: str) -> Path:
        return self._root / f"orders-{name}"


_NOW: Final = "now.json"
_NOTES: Final = "notes"
_NOTE_CHARACTERS: Final = 200
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
    text = msgspec.structs.replace(note, text=note.text[:_NOTE_CHARACTERS])
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

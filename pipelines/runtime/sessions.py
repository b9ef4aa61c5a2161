"""The sessions of this user on this machine: what they are called, and what the dead ones left.

A session lives as long as somebody holds the lock (flock(2)) on the file `launcher` in its
directory: the launcher, and with it all that it has forked. The kernel takes the lock back from
who is killed; a process id would not do, which another process, or the same one in another
container, may have.
"""

import fcntl
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from itertools import count
from pathlib import Path

from kontur_av.topics.session_files import make_session_root, remove_session, session_root

_LOCK = "launcher"


def new_session_name(setup: str, attempt: int = 0) -> str:
    """A name for a session of the setup called `setup`; it ends with this launcher's process id.

    attempt: counts the names that were taken already.
    """
    readable = re.sub("[^a-z0-9]+", "-", setup.lower())[:16].strip("-") or "session"
    return f"{readable}{f'-{attempt}' if attempt else ''}-{os.getpid()}"


@contextmanager
def hold_session(setup: str) -> Iterator[str]:
    """The name of a new session of the setup called `setup`, which is alive in this context.

    Afterwards nothing is left of it. ConfigError when the user's directory cannot be used.
    """
    names = (new_session_name(setup, attempt) for attempt in count())
    session, lock = next((name, lock) for name in names if (lock := _lock_new(name)) is not None)
    try:
        yield session
    finally:
        remove_session(session)
        os.close(lock)


def clear_dead_sessions() -> list[str]:
    """Remove what sessions whose launcher was killed have left; their names."""
    cleared = []
    everywhere = session_root("any").parent
    for directory in everywhere.glob("*-*") if everywhere.is_dir() else ():
        try:
            lock = os.open(directory / _LOCK, os.O_RDWR)
        except (FileNotFoundError, NotADirectoryError):
            # `kontur-av doctor` has a session without a launcher for a moment.
            owner = directory.name.rpartition("-")[2]
            if not owner.isdecimal() or Path(f"/proc/{owner}").exists():
                continue
            remove_session(directory.name)
            cleared.append(directory.name)
            continue
        try:
            if _locked(lock):
                # Held until all is removed, so that nobody begins in what vanishes.
                remove_session(directory.name)
                cleared.append(directory.name)
        finally:
            os.close(lock)
    return cleared


def _lock_new(session: str) -> int | None:
    """The lock's descriptor; None when somebody else has a session of that name."""
    path = session_root(session) / _LOCK
    while True:
        make_session_root(session)
        with suppress(FileNotFoundError):
            lock = os.open(path, os.O_RDWR | os.O_CREAT, 0o600)
            if not _locked(lock):
                os.close(lock)
                return None
            # Between the two lines above it may have been cleared away as a dead one's.
            if _same(lock, path):
                return lock
            os.close(lock)


def _locked(lock: int) -> bool:
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True


def _same(lock: int, path: Path) -> bool:
    try:
        return os.path.samestat(os.fstat(lock), path.stat())
    except FileNotFoundError:
        return False

"""The sessions of this user on this machine: their names, and the remains of dead ones.

A session is alive while its launcher, or a process forked from it, holds the lock (flock(2)) on the
file `launcher` in its directory. The kernel releases the lock of a killed process. A process id
would not do: another process, or one in another container, may have the same.
"""

import fcntl
import os
import re
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from itertools import count
from pathlib import Path

from kontur_av.topics.session_files import (
    LAUNCHER,
    make_session_root,
    remove_session,
    session_root,
    sessions,
)
from pipelines.session.kept_files import arm_stop
from pipelines.session.situation import Terminal


def new_session_name(setup: str, attempt: int = 0, *, end: str = "") -> str:
    """Return a name for a session of the setup `setup`, which ends with this process id.

    attempt: the number of names that were taken already. end: the only segment of it here.
    """
    readable = re.sub("[^a-z0-9]+", "-", setup.lower())[: 12 if end else 16].strip("-") or "session"
    if end:
        readable = f"{readable}-{end}"
    return f"{readable}{f'-{attempt}' if attempt else ''}-{os.getpid()}"


@contextmanager
def hold_session(setup: str, *, end: str = "") -> Iterator[str]:
    """Make a session of the setup `setup`, alive within this context, and yield its name.

    end: the only segment of it that runs here, which is then part of the name.
    It is removed afterwards. Raises ConfigError if the user's directory cannot be used.
    """
    names = (new_session_name(setup, attempt, end=end) for attempt in count())
    session, lock = next((name, lock) for name in names if (lock := _lock_new(name)) is not None)
    try:
        yield session
    finally:
        remove_session(session)
        os.close(lock)


def clear_dead_sessions() -> list[str]:
    """Remove the files of sessions whose launcher was killed, and return their names."""
    cleared = []
    everywhere = session_root("any").parent
    for directory in everywhere.glob("*-*") if everywhere.is_dir() else ():
        try:
            lock = os.open(directory / LAUNCHER, os.O_RDWR)
        except (FileNotFoundError, NotADirectoryError):
            # `kontur-av doctor` has a session without a launcher for a moment.
            owner = directory.name.rpartition("-")[2]
            if not owner.isdecimal() or Path(f"/proc/{owner}").exists():
                continue
            remove_session(directory.name)
            cleared.append(directory.name)
            continue
        try:
            if locks_now(lock):
                # Held until all is removed, so that no session begins in a vanishing directory.
                remove_session(directory.name)
                cleared.append(directory.name)
        finally:
            os.close(lock)
    return cleared


def _lock_new(session: str) -> int | None:
    """Return the lock's descriptor; None if another launcher has a session of that name."""
    path = session_root(session) / LAUNCHER
    while True:
        make_session_root(session)
        with suppress(FileNotFoundError):
            lock = os.open(path, os.O_RDWR | os.O_CREAT, 0o600)
            if not locks_now(lock):
                os.close(lock)
                return None
            # Another process may have removed the file before it was locked.
            with suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(lock), path.stat()):
                    os.pwrite(lock, str(os.getsid(0)).encode(), 0)
                    # Without room for it a stop is made when it is ordered.
                    with suppress(OSError):
                        arm_stop(session)
                    return lock
            os.close(lock)


def launched_sessions() -> list[str]:
    """Return this user's sessions that a launcher has started, sorted by name.

    Topics that a user's own programs share are none: they have no robot.
    """
    return [one for one in sessions() if (session_root(one) / LAUNCHER).exists()]


def terminal_of(session: str) -> Terminal:
    """A terminal's way to a session: its name must be given where others run, too."""
    return Terminal(session if len(launched_sessions()) > 1 else "")


def advised(command: str, session: str) -> str:
    """The command to give about a session."""
    return terminal_of(session).lines(command)


def is_alive(session: str) -> bool:
    try:
        lock = os.open(session_root(session) / LAUNCHER, os.O_RDWR)
    except OSError:
        return False
    try:
        return not locks_now(lock)
    finally:
        os.close(lock)


def started_here(session: str) -> bool:
    """Whether the session was started in the terminal of this process (setsid(2))."""
    try:
        return (session_root(session) / LAUNCHER).read_text() == str(os.getsid(0))
    except OSError:
        return False


def locks_now(lock: int) -> bool:
    """Lock an open file without waiting; whether nobody else has it locked."""
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except BlockingIOError:
        return False
    return True

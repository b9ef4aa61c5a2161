"""What a session has on disk and in shared memory, and whose it is."""

import hashlib
import os
import re
import shutil
import stat
import tempfile
from collections.abc import Sequence
from pathlib import Path

from kontur_av.errors import ConfigError

_SHARED_MEMORY = Path("/dev/shm")

#: A Unix socket's path has 107 octets (unix(7)); a session's directory may hold one, which is
#: called something short.
_SOCKET_PATH_OCTETS = 107
_SOCKET_NAME_OCTETS = 16
_SESSION_OCTETS = 31


def session_root(session: str) -> Path:
    """The directory of a session's files other than shared memory.

    ConfigError when somebody else could have put there what is found in it.
    """
    return user_root() / session


def make_session_root(session: str) -> None:
    """Make the directory of a session's files, if it is not there. Errors as `session_root`."""
    shared_memory_prefix(session)
    user_root().mkdir(mode=0o700, parents=True, exist_ok=True)
    # Asked for once more, because another user may have been faster.
    session_root(session).mkdir(mode=0o700, exist_ok=True)


def remove_session(session: str) -> int:
    """Remove what a session has left in shared memory and on disk; how many files it was.

    For the launcher, once all processes of the session have ended.
    """
    leftovers = shared_memory(session)
    for leftover in leftovers:
        leftover.unlink(missing_ok=True)
    shutil.rmtree(topics_root(session), ignore_errors=True)
    shutil.rmtree(session_root(session), ignore_errors=True)
    return len(leftovers)


def shared_memory(session: str) -> list[Path]:
    """What a session has in shared memory at present."""
    return list(_SHARED_MEMORY.glob(f"{shared_memory_prefix(session)}*"))


def sessions() -> list[str]:
    """This user's sessions that have something in shared memory, by name."""
    root = user_root()
    names = [path.name for path in root.iterdir() if path.is_dir()] if root.is_dir() else []
    return sorted(name for name in names if not name.startswith(".") and shared_memory(name))


def choose_session(name: str | None, running: Sequence[str], how: str = "") -> str:
    """The session of `running` that `name` means: its name, or the name of its setup.

    None: the only session. how: how the user names one, for the error.
    ConfigError, with the running ones, if it means none or several.
    """
    if not running:
        called = f" {name}" if name else ""
        raise ConfigError(
            f"no session{called} is running here: start one with "
            "`kontur-av stream --setup spacejustin`, "
            f"or set TMPDIR as it has it ({user_root()} has none)"
        )
    if name is None:
        chosen = list(running)
    elif name in running:
        chosen = [name]
    else:
        chosen = [session for session in running if session.startswith(f"{name}-")]
    if not chosen:
        raise ConfigError(f"no session {name} is running: choose one of {', '.join(running)}{how}")
    if len(chosen) > 1:
        raise ConfigError(f"several sessions are running: choose one of {', '.join(chosen)}{how}")
    return chosen[0]


def bell_path(session: str, topic: str) -> Path:
    """The FIFO that wakes the readers of a topic; `remove_session` removes it.

    Where no file system keeps a journal of when it was written to.
    """
    digest = hashlib.sha256(topic.encode()).hexdigest()[:16]
    return _SHARED_MEMORY / f"{shared_memory_prefix(session)}{digest}.bell"


def user_root() -> Path:
    """This user's directory for all sessions: where TMPDIR says, if a socket's path fits there."""
    own = f"kontur-av-{os.getuid()}"
    chosen = Path(tempfile.gettempdir()) / own
    longest = len(os.fsencode(chosen)) + 1 + _SESSION_OCTETS + 1 + _SOCKET_NAME_OCTETS
    if longest > _SOCKET_PATH_OCTETS:
        chosen = Path("/tmp") / own
    _check_own(chosen)
    return chosen


def _check_own(directory: Path) -> None:
    """ConfigError when another user could write there: /tmp is everybody's."""
    try:
        found = directory.lstat()
    except FileNotFoundError:
        return
    if not stat.S_ISDIR(found.st_mode) or found.st_uid != os.getuid():
        raise ConfigError(
            f"{directory} is no directory of yours: remove it, "
            "or set TMPDIR to a directory of your own"
        )
    if found.st_mode & 0o022:
        raise ConfigError(
            f"{directory} may be written by others: look what is in it, then chmod 700 it"
        )


def topics_root(session: str) -> Path:
    """Where the topics of a session keep what is no shared memory."""
    return user_root() / f".{_digest(session)}"


def shared_memory_prefix(session: str) -> str:
    """How the names of a session's shared memory begin; ConfigError for an unfit session name."""
    if not re.fullmatch(rf"[a-z0-9][a-z0-9-]{{0,{_SESSION_OCTETS - 1}}}", session):
        raise ConfigError(
            f"session name {session!r}: at most {_SESSION_OCTETS} lower-case letters, digits "
            "and hyphens"
        )
    return f"kontur-av-{_digest(session)}_"


def _digest(session: str) -> str:
    """Stands for the session in names that have no room for its own."""
    return hashlib.sha256(session.encode()).hexdigest()[:8]

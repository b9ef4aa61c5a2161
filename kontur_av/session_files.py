"""What a session has on disk and in shared memory, and whose it is."""

import hashlib
import os
import re
import shutil
import stat
import tempfile
from pathlib import Path

from kontur_av.errors import ConfigError

#: A Unix socket's path has 107 octets (unix(7)); iceoryx2 adds an identifier of up to 39 digits
#: and an ending to the prefix.
_SOCKET_PATH_OCTETS = 107
_SOCKET_NAME_OCTETS = 39 + len(".event")


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
    return list(Path("/dev/shm").glob(f"{shared_memory_prefix(session)}*"))


def user_root() -> Path:
    """This user's directory for all sessions: where TMPDIR says, if a socket's path fits there."""
    own = f"kontur-av-{os.getuid()}"
    chosen = Path(tempfile.gettempdir()) / own
    longest = f"{chosen}/.{_digest('')}/{shared_memory_prefix('x')}"
    if len(os.fsencode(longest)) + _SOCKET_NAME_OCTETS > _SOCKET_PATH_OCTETS:
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
    """Where the topics of a session keep what is no shared memory, under a short name."""
    return user_root() / f".{_digest(session)}"


def shared_memory_prefix(session: str) -> str:
    """How the names of a session's shared memory begin; ConfigError for an unfit session name."""
    if not re.fullmatch(r"[a-z0-9][a-z0-9-]{0,30}", session):
        raise ConfigError(
            f"session name {session!r}: at most 31 lower-case letters, digits and hyphens"
        )
    return f"kontur-av-{_digest(session)}_"


def _digest(session: str) -> str:
    """Stands for the session where its name would make a socket's path too long."""
    return hashlib.sha256(session.encode()).hexdigest()[:8]

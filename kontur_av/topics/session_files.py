"""The files and the shared memory of a session, and the checks of their ownership."""

import errno
import fcntl
import hashlib
import os
import pwd
import re
import shutil
import stat
from collections.abc import Sequence
from contextlib import suppress
from pathlib import Path

from kontur_av.errors import ConfigError

SHARED_MEMORY = Path("/dev/shm")

#: A Unix socket's path has at most 107 octets (unix(7)). A session's directory may hold one, with
#: a name of at most 16 octets.
_SOCKET_PATH_OCTETS = 107
_SOCKET_NAME_OCTETS = 16
_SESSION_OCTETS = 31

#: In a session's directory: what its launcher locks, and what each user of its topics locks.
LAUNCHER, _USERS = "launcher", "users"


def session_root(session: str) -> Path:
    """Return the directory of a session's files other than shared memory.

    Raises ConfigError if another user could have written to it.
    """
    return user_root() / session


def make_session_root(session: str) -> None:
    """Create the directory of a session's files if it is missing. Errors: see `session_root`."""
    shared_memory_prefix(session)
    user_root().mkdir(mode=0o700, parents=True, exist_ok=True)
    # Check again, because another user may have created the directory in between.
    session_root(session).mkdir(mode=0o700, exist_ok=True)


def remove_session(session: str) -> int:
    """Remove what a session left in shared memory and on disk; return the number of files.

    For the launcher, after all processes of the session have ended.
    """
    leftovers = shared_memory(session)
    for leftover in leftovers:
        leftover.unlink(missing_ok=True)
    shutil.rmtree(topics_root(session), ignore_errors=True)
    shutil.rmtree(session_root(session), ignore_errors=True)
    return len(leftovers)


def join_session(session: str) -> int:
    """Use a session's topics, until `leave_session`; return the file descriptor that shows it.

    The lock (flock(2)) is shared; the kernel releases that of a killed process.
    """
    path = session_root(session) / _USERS
    while True:
        make_session_root(session)
        with suppress(FileNotFoundError):
            users = open_own_file(path)
            fcntl.flock(users, fcntl.LOCK_SH)
            # Another process may have removed the file before it was locked.
            with suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(users), path.stat()):
                    return users
            os.close(users)


def leave_session(session: str, users: int) -> None:
    """End the use. The last user removes the topics, unless a launcher will do so."""
    root = session_root(session)
    with suppress(BlockingIOError):
        fcntl.flock(users, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if not (root / LAUNCHER).exists():
            for leftover in shared_memory(session):
                leftover.unlink(missing_ok=True)
            shutil.rmtree(topics_root(session), ignore_errors=True)
            (root / _USERS).unlink(missing_ok=True)
            # What others keep there stays.
            with suppress(OSError):
                root.rmdir()
    os.close(users)


def shared_memory(session: str) -> list[Path]:
    """Return the session's present files in shared memory."""
    return list(SHARED_MEMORY.glob(f"{shared_memory_prefix(session)}*"))


def sessions() -> list[str]:
    """Return this user's sessions that have something in shared memory, sorted by name."""
    root = user_root()
    names = [path.name for path in root.iterdir() if path.is_dir()] if root.is_dir() else []
    return sorted(name for name in names if not name.startswith(".") and shared_memory(name))


def _other_users() -> list[str]:
    """Return the other users who have sessions here, by name, or by number if they have none."""
    owners = set()
    for path in SHARED_MEMORY.glob("kontur-av-*_*"):
        with suppress(FileNotFoundError):
            owners.add(path.lstat().st_uid)
    names = {one.pw_uid: one.pw_name for one in pwd.getpwall()}
    return [names.get(uid, f"#{uid}") for uid in sorted(owners - {os.getuid()})]


def fitting(name: str | None, running: Sequence[str]) -> list[str]:
    """The sessions of `running` that `name` may mean: its name, that of its setup; None: any."""
    if name is None or name in running:
        return list(running) if name is None else [name]
    return [session for session in running if session.startswith(f"{name}-")]


def choose_session(name: str | None, running: Sequence[str], how: str = "") -> str:
    """Return the session of `running` that `name` means: its name, or the name of its setup.

    name: None means the only session.
    how: added to the error; says how the user can name a session.
    Raises ConfigError, with the running sessions, if none or several fit.
    """
    if not running:
        called = f" {name}" if name else ""
        if users := _other_users():
            raise ConfigError(
                f"no session{called} of yours is running here, "
                f"but one of user {' and of '.join(users)}: "
                f"give the command as that user, such as `sudo -u {users[0]} kontur-av ...`"
            )
        raise ConfigError(
            f"no session{called} is running here: start one with "
            "`kontur-av stream --setup spacejustin`, "
            f"or set TMPDIR as the session has it ({user_root()} has none)"
        )
    chosen = fitting(name, running)
    if not chosen:
        raise ConfigError(f"no session {name} is running: choose one of {', '.join(running)}{how}")
    if len(chosen) > 1:
        raise ConfigError(f"several sessions are running: choose one of {', '.join(chosen)}{how}")
    return chosen[0]


def topic_path(session: str, topic: str, suffix: str) -> Path:
    """Return a file of a topic in shared memory; `remove_session` removes it."""
    digest = hashlib.sha256(topic.encode()).hexdigest()[:16]
    return SHARED_MEMORY / f"{shared_memory_prefix(session)}{digest}{suffix}"


def notifier_path(session: str, topic: str) -> Path:
    """Return the FIFO that wakes the readers of a topic."""
    return topic_path(session, topic, ".notifier")


def open_own_file(path: Path, flags: int = 0) -> int:
    """Open a file to read and write; ConfigError if another user made it, as /dev/shm is shared."""
    always = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_CLOEXEC
    foreign = ConfigError(f"{path} is no file of yours: remove it")
    try:
        descriptor = os.open(path, flags | always, 0o600)
    except OSError as error:
        if error.errno in (errno.EACCES, errno.EPERM, errno.ELOOP, errno.EISDIR):
            raise foreign from None
        raise
    found = os.fstat(descriptor)
    if not stat.S_ISREG(found.st_mode) or found.st_uid != os.geteuid():
        os.close(descriptor)
        raise foreign
    return descriptor


def joins_path(session: str, topic: str) -> Path:
    """Return the file that has one octet for each reader that ever joined a topic."""
    return topic_path(session, topic, ".joins")


def user_root() -> Path:
    """Return this user's directory for all sessions: in TMPDIR, if a socket's path fits there.

    Without TMPDIR it is in shared memory. Processes in real time write to it, and a busy disk would
    keep them for seconds.

    Python's `tempfile` would write a file to try each directory. On a full disk it takes another
    one, or none, and an emergency stop would not find its session.
    """
    own = f"kontur-av-{os.getuid()}"
    named = (os.environ.get(name) for name in ("TMPDIR", "TEMP", "TMP"))
    for directory in (*filter(None, named), str(SHARED_MEMORY), "/tmp", "/var/tmp", os.curdir):
        chosen = Path(directory).absolute() / own
        longest = len(os.fsencode(chosen)) + 1 + _SESSION_OCTETS + 1 + _SOCKET_NAME_OCTETS
        if longest > _SOCKET_PATH_OCTETS:
            continue
        # No file passes as a directory with "/." behind it.
        if os.access(chosen, os.X_OK) or os.access(f"{directory}/.", os.W_OK | os.X_OK):
            break
    else:
        raise ConfigError("no directory for temporary files: set TMPDIR to one of your own")
    _check_own(chosen)
    return chosen


def _check_own(directory: Path) -> None:
    """Raise ConfigError if another user could write to `directory`, as /tmp is shared."""
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
            f"others may write to {directory}: check what is in it, then chmod 700 it"
        )


def topics_root(session: str) -> Path:
    """Return the directory of a session's topics other than shared memory."""
    return user_root() / f".{_digest(session)}"


def shared_memory_prefix(session: str) -> str:
    """Return the prefix of a session's shared memory; ConfigError for an unfit session name."""
    if not re.fullmatch(rf"[a-z0-9][a-z0-9-]{{0,{_SESSION_OCTETS - 1}}}", session):
        raise ConfigError(
            f"session name {session!r}: at most {_SESSION_OCTETS} lower-case letters, digits "
            "and hyphens"
        )
    return f"kontur-av-{_digest(session)}_"


def _digest(session: str) -> str:
    """Return a short stand-in for names that have no room for the session's own."""
    return hashlib.sha256(session.encode()).hexdigest()[:8]


def partial_of(path: Path) -> Path:
    """Return where this process writes what will replace a file."""
    return path.with_name(f"{path.name}.{os.getpid()}.new")


def replace_file(path: Path, content: bytes) -> None:
    """Replace a file in one step, so that a killed process leaves the old or the new content."""
    partial = partial_of(path)
    partial.write_bytes(content)
    partial.replace(path)


def remember(path: Path, content: bytes) -> None:
    """Keep what a process shall know after a restart.

    On a full disk the file becomes empty: something was to be kept, and nobody knows what. So a
    full disk ends no process, and old content does not come back.
    """
    with suppress(OSError):
        try:
            replace_file(path, content)
        except OSError:
            path.write_bytes(b"")

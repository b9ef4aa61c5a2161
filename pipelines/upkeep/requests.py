"""One keeper of a directory: its files, lock, inbox and program, and orders of other commands.

A lock says whether a keeper runs. An order is a file that the keeper answers by another. A program
is the file `run` of a folder; it is watched, and tells its status.
"""

import errno
import os
import signal
import stat
import subprocess
import time
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from kontur_av.clock import NS_PER_MS
from kontur_av.errors import ConfigError, refused
from pipelines.session.command_process import end_with_parent
from pipelines.session.sessions import locks_now
from telepresence.upkeep.file_store import FileStore, StoredFile, replace_file
from telepresence.upkeep.inbox import (
    LARGEST_TOLD,
    MOST_ARCHIVE_OCTETS,
    TOLD,
    FileStamp,
    UpdateInbox,
    read_archive,
    version_of,
)
from telepresence.upkeep.manifest import RUN
from telepresence.upkeep.version_stack import VARIABLE, VersionStatus, pack_status

#: How long a program may take to end after SIGTERM.
_END_S = 10.0
_LARGEST_STATUS = 4096


class Program:
    """Starts and ends one program at a time. status: the file in which it tells how it is."""

    def __init__(self, status: Path, arguments: Sequence[str]) -> None:
        self._status, self._arguments = status.absolute(), list(arguments)
        self._process: subprocess.Popen[bytes] | None = None
        self._seen: tuple[int, int] | None = None

    def start(self, folder: Path) -> bool:
        self.stop()
        with suppress(OSError):
            self._status.unlink()
        self._seen = None
        try:
            self._process = subprocess.Popen(
                [str((folder / RUN).absolute()), *self._arguments],
                cwd=folder,
                # Python would replace signed files of `__pycache__`.
                env={"PYTHONDONTWRITEBYTECODE": "1", **os.environ, VARIABLE: str(self._status)},
                stdin=subprocess.DEVNULL,
                # Its children end with it, and Ctrl-C does not reach it twice.
                start_new_session=True,
                # One that outlived a killed keeper would hold the ports of the next.
                preexec_fn=end_with_parent,
            )
        except OSError:
            return False
        return True

    def stop(self) -> None:
        """End the program and its children, if it runs."""
        process, self._process = self._process, None
        if process is None:
            return
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGTERM)
        with suppress(subprocess.TimeoutExpired):
            process.wait(_END_S)
        with suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()

    def exit_code(self) -> int | None:
        """The exit code of a program that has ended by itself, once; None else."""
        code = None if self._process is None else self._process.poll()
        if code is not None:
            # Children that it has left behind.
            self.stop()
        return code

    def news(self) -> bytes | None:
        """What the program has told since the last call; None if it has told nothing."""
        try:
            # Do not block: the program may have made a FIFO of it.
            flags = os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC
            with os.fdopen(os.open(self._status, flags), "rb") as file:
                state = os.fstat(file.fileno())
                told = state.st_ino, state.st_mtime_ns
                octets = file.read(_LARGEST_STATUS)
        except OSError:
            return None
        if told == self._seen:
            return None
        self._seen = told
        return octets


def status_teller() -> Callable[[VersionStatus], None] | None:
    """Return what tells the status to whom runs this process; None if nobody asks for it."""
    name = os.environ.get(VARIABLE)
    if not name:
        return None
    path = Path(name)

    def publish(status: VersionStatus) -> None:
        # A full disk must not end the link: silence tells enough.
        with suppress(OSError):
            unfinished = path.with_name(f"{path.name}.{os.getpid()}")
            unfinished.write_bytes(pack_status(status))
            unfinished.replace(path)

    return publish


class DiskStore(FileStore):
    """Files below `root`, which is made when a file is written."""

    def __init__(self, root: Path) -> None:
        self.root = root

    def files(self, folder: str) -> list[str]:
        top = self.root / folder
        found = []
        for at, folders, names in os.walk(top):
            here = Path(at).relative_to(top)
            # A link to a folder may lead out of this one.
            links = [each for each in folders if (Path(at) / each).is_symlink()]
            found += [(here / name).as_posix() for name in (*names, *links)]
            if not names and not folders and at != str(top):
                found.append(f"{here.as_posix()}/")
        return sorted(found)

    def read(self, path: str) -> bytes:
        # Do not block: a FIFO may have no writer.
        flags = os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC | os.O_NONBLOCK
        with os.fdopen(os.open(self.root / path, flags), "rb") as file:
            if not stat.S_ISREG(os.fstat(file.fileno()).st_mode):
                raise OSError(errno.EINVAL, f"{path} is no regular file")
            return file.read()

    def is_executable(self, path: str) -> bool:
        return os.access(self.root / path, os.X_OK)

    def write(self, path: str, octets: bytes, *, executable: bool = False) -> None:
        place = self.root / path
        made = [each for each in (place.parent, *place.parent.parents) if not each.exists()]
        place.parent.mkdir(parents=True, exist_ok=True)
        flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_NOFOLLOW | os.O_CLOEXEC
        with os.fdopen(os.open(place, flags, 0o755 if executable else 0o644), "wb") as file:
            file.write(octets)
            file.flush()
            os.fchmod(file.fileno(), 0o755 if executable else 0o644)
            os.fsync(file.fileno())
        for folder in (place.parent, *(each.parent for each in made)):
            _sync(folder)

    def rename(self, old: str, new: str) -> None:
        source, target = self.root / old, self.root / new
        source.replace(target)
        _sync(target.parent)
        if source.parent != target.parent:
            _sync(source.parent)

    def remove(self, path: str) -> None:
        place = self.root / path
        try:
            if path.endswith("/"):
                place.rmdir()
            else:
                place.unlink()
        except (FileNotFoundError, NotADirectoryError):
            return
        while (place := place.parent) != self.root and not any(place.iterdir()):
            place.rmdir()
        _sync(place)


def _sync(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


_LOCK, _ORDER, _ANSWER = ".lock", ".order", ".answer"
_TIMEOUT_S = 20.0
_POLL_S = 0.05
_LARGEST_ORDER = 4096
#: A keeper that starts waits so long for a command that looks or orders.
_START_S = 2.0


@contextmanager
def kept(directory: Path, *, wait_s: float = 0.0) -> Iterator[bool]:
    """Keep a directory while this lasts; yield whether nobody else does.

    wait_s: so long it waits for who else does.
    """
    ends_s = time.monotonic() + wait_s
    directory.mkdir(parents=True, exist_ok=True)
    descriptor = os.open(directory / _LOCK, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o600)
    try:
        while not (free := locks_now(descriptor)) and time.monotonic() < ends_s:
            time.sleep(_POLL_S)
        yield free
    finally:
        os.close(descriptor)


@contextmanager
def keeping(directory: Path) -> Iterator[None]:
    """Be the keeper of a directory while this lasts. Raises ConfigError if another is."""
    with kept(directory, wait_s=_START_S) as free:
        if not free:
            raise ConfigError(f"{directory} runs already")
        yield


def answer_order(directory: Path, act: Callable[[str], None]) -> None:
    """Do an order that waits, if there is one, and answer it."""
    order = directory / _ORDER
    try:
        with order.open() as file:
            text = file.read(_LARGEST_ORDER)
        order.unlink()
    except (OSError, UnicodeDecodeError):
        return
    answer = ""
    try:
        act(text)
    except ConfigError as error:
        answer = str(error)
    with suppress(OSError):
        _replace(directory / _ANSWER, answer)


def give_order(directory: Path, order: str) -> None:
    """Let the keeper do an order. Raises ConfigError with its answer, or if none comes."""
    answer = directory / _ANSWER
    answer.unlink(missing_ok=True)
    _replace(directory / _ORDER, order)
    until_s = time.monotonic() + _TIMEOUT_S
    while time.monotonic() < until_s:
        if answer.exists():
            text = answer.read_text()
            answer.unlink(missing_ok=True)
            if text:
                raise ConfigError(text)
            return
        time.sleep(_POLL_S)
    (directory / _ORDER).unlink(missing_ok=True)
    raise ConfigError(f"what runs in {directory} does not answer: is it stopped?")


def _replace(path: Path, text: str) -> None:
    unfinished = path.with_name(f"{path.name}.{os.getpid()}")
    unfinished.write_text(text)
    unfinished.replace(path)


_LOOK_NS = 500 * NS_PER_MS


class InboxFolder:
    """Made once by a keeper; raises ConfigError for a folder that cannot be.

    add: takes a version's name and the files of an archive; order: takes a line. Both raise
    ConfigError, and return what to tell. words: the orders that there are.
    """

    def __init__(
        self,
        folder: Path,
        words: Collection[str],
        *,
        add: Callable[[str, Mapping[str, StoredFile]], str],
        order: Callable[[str], str],
    ) -> None:
        with refused(f"--inbox {folder}"):
            folder.mkdir(parents=True, exist_ok=True)
        self._folder, self._store = folder, DiskStore(folder)
        self._add, self._order = add, order
        told = b""
        with suppress(OSError):
            told = self._read(TOLD, LARGEST_TOLD)
        self._inbox = UpdateInbox(words, told)
        self._told, self._look_ns = b"", 0

    def work(self, *, busy: bool, now_ns: int) -> None:
        """Look into the folder now and then, and do what is due."""
        if now_ns < self._look_ns:
            return
        self._look_ns = now_ns + _LOOK_NS
        self._inbox.handle_files(self._files(), now_ns)
        self._inbox.handle_busy(busy)
        if (name := self._inbox.next_file(now_ns)) is None:
            return
        text = refusal = ""
        try:
            text = self._take(name)
        except ConfigError as error:
            refusal = str(error)
        except OSError as error:
            refusal = f"the disk: {error.strerror or error}"
        with suppress(OSError):
            self._store.rename(name, self._inbox.handle_done(name, text, refusal))

    def publish(self, runs: str, why: str, states: Mapping[str, str]) -> None:
        """Let the other end read what runs, if that is news."""
        told = self._inbox.told(runs, why, states)
        if told != self._told:
            self._told = told
            # A full disk must not end what runs.
            with suppress(OSError):
                replace_file(self._store, TOLD, told)

    def _files(self) -> dict[str, FileStamp]:
        found = {}
        with suppress(OSError), os.scandir(self._folder) as entries:
            for entry in entries:
                # A link may lead out of the folder.
                if entry.is_file(follow_symlinks=False):
                    state = entry.stat(follow_symlinks=False)
                    found[entry.name] = FileStamp(state.st_mtime_ns, state.st_ino, state.st_size)
        return found

    def _take(self, name: str) -> str:
        octets = self._read(name, MOST_ARCHIVE_OCTETS + 1)
        if version := version_of(name):
            return self._add(version, read_archive(octets))
        return self._order(self._inbox.order_of(octets))

    def _read(self, name: str, most: int) -> bytes:
        descriptor = os.open(self._folder / name, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC)
        with os.fdopen(descriptor, "rb") as file:
            return file.read(most)

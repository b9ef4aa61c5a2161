"""Recordings and exports as files: their octets, and names only for what is whole."""

import errno
import fcntl
import mmap
import os
import stat
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Self

from kontur_av.errors import ConfigError, refused


def _unfinished(path: Path) -> Path:
    """The name of a file until it is whole. Each program has its own, so that none mixes in."""
    return path.with_name(f"{path.name}.{os.getpid()}.unfinished")


def _finish(path: Path, *, overwrite: bool) -> None:
    """Give a whole file its name; ConfigError if another program has written it meanwhile."""
    if not overwrite:
        try:
            path.open("xb").close()
        except FileExistsError:
            raise ConfigError(f"{path} was written by another program meanwhile") from None
    _unfinished(path).replace(path)


def octets_of_file(path: Path) -> memoryview:
    """Return what is in a file, without reading it yet; ConfigError if that is not possible."""
    if path.exists() and not path.is_file():
        raise ConfigError(f"{path} is no file: give a recording")
    with refused(f"{path} cannot be read"), path.open("rb") as file:
        if not os.fstat(file.fileno()).st_size:
            return memoryview(b"")
        return memoryview(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))


def open_alone(path: Path) -> int:
    """Open a file to write it anew, and keep other programs that do the same out of it.

    OSError if that is not possible.
    """
    file = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_CLOEXEC, 0o666)
    try:
        if stat.S_ISREG(os.fstat(file).st_mode):
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            os.ftruncate(file, 0)
    except BlockingIOError:
        os.close(file)
        raise OSError(errno.EBUSY, "another program is writing it") from None
    return file


def check_new(path: Path, *, overwrite: bool) -> None:
    """Raise ConfigError unless `path` may be written: it is new, or may be replaced."""
    if path.is_dir():
        raise ConfigError(f"{path} is a directory: give the name of a file")
    if path.exists() and not overwrite:
        raise ConfigError(f"{path} exists: give another name, or --overwrite")


def write_whole(path: Path, pieces: Iterable[bytes], *, overwrite: bool) -> None:
    """Write a file that has its name only once it is whole and on the disk.

    Raises ConfigError as `check_new`, and if it cannot be written; nothing is left of it then.
    """
    check_new(path, overwrite=overwrite)
    unfinished = _unfinished(path)
    with refused(f"{path} cannot be written"):
        try:
            # A recording is for its user alone: it has pictures, voices and the hand.
            flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC
            with os.fdopen(os.open(unfinished, flags, 0o600), "wb") as file:
                file.writelines(pieces)
                file.flush()
                os.fsync(file.fileno())
            _finish(path, overwrite=overwrite)
        finally:
            unfinished.unlink(missing_ok=True)


class Outputs:
    """The files of an export, as a context.

    Within it, write to `unfinished(path)`. At its end each file gets its name; after an exception
    none does, and nothing is left. An OSError within becomes a ConfigError.
    """

    def __init__(self, *, overwrite: bool) -> None:
        self._overwrite = overwrite
        self._paths: list[Path] = []
        self._made: list[Path] = []

    def check(self, paths: Iterable[Path], inputs: Iterable[Path]) -> None:
        """Raise ConfigError if one of the paths exists and may not be replaced, or is an input."""
        read = [*inputs]
        for path in paths:
            for source in read:
                if path.exists() and path.samefile(source):
                    raise ConfigError(f"{path} is the recording itself: give another name")
            check_new(path, overwrite=self._overwrite)

    def make_directory(self, path: Path) -> None:
        """Make a directory for files, if it is missing; ConfigError if that is not possible."""
        if path.exists() and not path.is_dir():
            raise ConfigError(f"{path} is no directory: give the name of one")
        # Noted first, so that an interrupt in between leaves nothing.
        self._made.append(path)
        try:
            path.mkdir()
        except FileExistsError:
            self._made.remove(path)
        except OSError as error:
            raise ConfigError(f"{path} cannot be made: {error.strerror}") from None

    def unfinished(self, path: Path) -> Path:
        """Return the name under which to write a file; ConfigError if that is not possible."""
        unfinished = _unfinished(path)
        self._paths.append(path)
        try:
            unfinished.open("wb").close()
        except OSError as error:
            self._paths.remove(path)
            raise ConfigError(f"{path} cannot be written: {error.strerror}") from None
        return unfinished

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: object, error: object, trace: object) -> None:
        try:
            if kind is None:
                for path in self._paths:
                    with _unfinished(path).open("rb") as file:
                        os.fsync(file.fileno())
                for path in self._paths:
                    _finish(path, overwrite=self._overwrite)
                self._made.clear()
        except OSError as failed:
            error = failed
        finally:
            for path in self._paths:
                with suppress(OSError):
                    _unfinished(path).unlink(missing_ok=True)
            for directory in reversed(self._made):
                with suppress(OSError):
                    directory.rmdir()
        if isinstance(error, OSError):
            raise ConfigError(f"the export cannot be written: {error.strerror}") from None

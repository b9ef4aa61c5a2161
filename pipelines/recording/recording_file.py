"""Recordings as files: their octets, and how a new one comes to be."""

import mmap
import os
from collections.abc import Iterable
from pathlib import Path

from kontur_av.errors import ConfigError

_UNFINISHED = ".unfinished"


def octets_of_file(path: Path) -> memoryview:
    """Return what is in a file, without reading it yet; ConfigError if that is not possible."""
    if path.exists() and not path.is_file():
        raise ConfigError(f"{path} is no file: give a recording")
    try:
        with path.open("rb") as file:
            if not os.fstat(file.fileno()).st_size:
                return memoryview(b"")
            return memoryview(mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ))
    except OSError as error:
        raise ConfigError(f"{path} cannot be read: {error.strerror}") from None


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
    unfinished = path.with_name(path.name + _UNFINISHED)
    try:
        try:
            # A recording is for its user alone: it has pictures, voices and the hand.
            flags = os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC
            with os.fdopen(os.open(unfinished, flags, 0o600), "wb") as file:
                file.writelines(pieces)
                file.flush()
                os.fsync(file.fileno())
            unfinished.replace(path)
        finally:
            unfinished.unlink(missing_ok=True)
    except OSError as error:
        raise ConfigError(f"{path} cannot be written: {error.strerror}") from None

"""A folder of this machine as a `FileStore`: what was written is on the disk on return."""

import os
from pathlib import Path

from telepresence.upkeep.file_store import FileStore


class DiskStore(FileStore):
    """Files below `root`, which is made when a file is written."""

    def __init__(self, root: Path) -> None:
        self.root = root

    def files(self, folder: str) -> list[str]:
        top = self.root / folder
        found = []
        for at, folders, names in os.walk(top):
            # A link may lead out of the folder, so it is no file of it.
            folders[:] = [each for each in folders if not (Path(at) / each).is_symlink()]
            paths = (Path(at) / name for name in names)
            found += [each.relative_to(top).as_posix() for each in paths if not each.is_symlink()]
        return sorted(found)

    def read(self, path: str) -> bytes:
        descriptor = os.open(self.root / path, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC)
        with os.fdopen(descriptor, "rb") as file:
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
        if source.is_dir() and target.is_dir():
            # Removing all of its files leaves its folders.
            _remove_empty(target)
        source.replace(target)
        _sync(target.parent)
        if source.parent != target.parent:
            _sync(source.parent)

    def remove(self, path: str) -> None:
        place = self.root / path
        try:
            place.unlink()
        except (FileNotFoundError, NotADirectoryError):
            return
        _sync(place.parent)


def _remove_empty(folder: Path) -> None:
    for at, _, _ in os.walk(folder, topdown=False):
        Path(at).rmdir()


def _sync(folder: Path) -> None:
    descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_CLOEXEC)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)

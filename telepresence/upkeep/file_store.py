"""Folders of files that survive a power cut, wherever the files lie. A core.

A folder is written so that it counts only when it is whole: its list of checksums comes last.
"""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Protocol

from kontur_av.errors import ConfigError, refused

#: What a file has in its name until it is whole.
UNFINISHED = ".unfinished"
_LONGEST_PATH = 1000


class FileStore(Protocol):
    """Files by their path, with `/` between folders. Each method returns when it is safe.

    OSError: it is missing or no plain file, or the disk is bad.
    """

    def files(self, folder: str) -> list[str]:
        """Paths of all files below a folder, from there, sorted; none if it is not there.

        Links, sockets and the like count as files; an empty folder's path ends with `/`.
        """
        ...

    def read(self, path: str) -> bytes: ...

    def is_executable(self, path: str) -> bool: ...

    def write(self, path: str, octets: bytes, *, executable: bool = False) -> None:
        """Make or overwrite a file. Power that fails meanwhile leaves any part of it."""
        ...

    def rename(self, old: str, new: str) -> None:
        """Rename a file or a folder at once; a file of the new name goes."""
        ...

    def remove(self, path: str) -> None:
        """Remove a file and the folders that it leaves empty; nothing if it is not there."""
        ...


@dataclass(frozen=True, slots=True)
class StoredFile:
    """What a file has."""

    octets: bytes
    executable: bool = False


def read_folder(store: FileStore, folder: str) -> dict[str, StoredFile]:
    """All files below a folder; "" is the store itself. ConfigError for what no copy can hold."""
    top = f"{folder}/" if folder else ""
    files = {}
    for path in store.files(folder):
        if path.endswith("/"):
            raise ConfigError(f"{path!r} is an empty folder: put a file into it, or remove it")
        if not safe_path(path):
            raise ConfigError(f"{path!r} is no name for every machine: rename the file")
        with refused(f"{path!r}: put a plain file in its place, or remove it"):
            files[path] = StoredFile(store.read(top + path), store.is_executable(top + path))
    return files


def read_listed(
    store: FileStore, folder: str, last: str, paths_of: Callable[[bytes], Iterable[str]]
) -> dict[str, StoredFile]:
    """A folder's list `last`, and those files of it that are there. ValueError if it is damaged.

    What a program has written into its folder is not in the list, and may be anything.
    """
    there = set(store.files(folder))
    if last not in there:
        return {}
    listed = [last, *paths_of(store.read(f"{folder}/{last}"))]
    return {
        path: StoredFile(store.read(f"{folder}/{path}"), store.is_executable(f"{folder}/{path}"))
        for path in listed
        if path in there
    }


def replace_file(store: FileStore, path: str, octets: bytes) -> None:
    """Give a file new octets: at every instant it has the old or the new ones, whole."""
    store.write(path + UNFINISHED, octets)
    store.rename(path + UNFINISHED, path)


def fill_folder(store: FileStore, folder: str, files: Mapping[str, StoredFile], last: str) -> None:
    """Make a folder have just these files. The list of checksums `last` goes first, comes last."""
    store.remove(f"{folder}/{last}")
    for path in store.files(folder):
        if path not in files:
            store.remove(f"{folder}/{path}")
    for path, file in files.items():
        if path != last:
            store.write(f"{folder}/{path}", file.octets, executable=file.executable)
    replace_file(store, f"{folder}/{last}", files[last].octets)


def safe_path(path: str) -> bool:
    """Whether a path stays within its folder, and can stand in a list and on a disk."""
    parts = path.split("/")
    odd = path[:1] == ";" or path != path.strip() or "\\" in path or not path.isprintable()
    if odd or len(path.encode()) > _LONGEST_PATH:
        return False
    return not {"", ".", ".."} & {*parts} and all(len(part.encode()) < 256 for part in parts)

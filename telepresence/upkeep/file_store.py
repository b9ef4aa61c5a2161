"""Folders of files that survive a power cut, wherever the files lie. A core.

A folder is written so that it counts only when it is whole: its list of checksums comes last.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

#: What a file has in its name until it is whole.
UNFINISHED = ".unfinished"


class FileStore(Protocol):
    """Files by their path, with `/` between folders. Each method returns when it is safe.

    OSError of a missing file or a bad disk passes through. Paths with symbolic links are not read.
    """

    def files(self, folder: str) -> list[str]:
        """Paths of all files below a folder, from there, sorted; none if it is not there."""
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
        """Remove a file; nothing happens if it is not there."""
        ...


@dataclass(frozen=True, slots=True)
class StoredFile:
    """What a file has."""

    octets: bytes
    executable: bool = False


def read_folder(store: FileStore, folder: str) -> dict[str, StoredFile]:
    """All files below a folder; "" is the store itself."""
    top = f"{folder}/" if folder else ""
    return {
        path: StoredFile(store.read(top + path), store.is_executable(top + path))
        for path in store.files(folder)
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
    """Whether a path from a list stays within its folder."""
    parts = path.split("/")
    return "\0" not in path and "\\" not in path and not {"", ".", ".."} & set(parts)

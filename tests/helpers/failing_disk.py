"""A disk whose power fails at any octet: what was not safe by then may be lost."""

from random import Random

from telepresence.upkeep.file_store import StoredFile


def software(random: Random, edition: str) -> dict[str, StoredFile]:
    """The files of an edition; some are equal in all, as libraries are."""
    files = {
        "run": StoredFile(f"#!/bin/sh\n# {edition}\n".encode(), executable=True),
        "lib/same.so": StoredFile(bytes(range(200))),
    }
    for number in range(random.randint(0, 3)):
        octets = random.randbytes(random.randint(0, 300))
        files[f"lib/{random.choice('abc')}{number}"] = StoredFile(octets)
    return files


class PowerFailedError(Exception):
    """Power has failed; `FailingDisk.powered_again` has what is left."""


class FailingDisk:
    """A `FileStore` in memory. fuse: octets, and other changes, until power fails; None: never.

    As on a disk that keeps its order: each change is whole, but for the octets of a write. A file
    that is overwritten loses its old octets first. A rename is done at once, or not.
    """

    def __init__(self, fuse: int | None = None) -> None:
        self.content: dict[str, tuple[bytes, bool]] = {}
        self.fuse = fuse

    def _burn(self, size: int) -> int:
        """How much of a change of this size is done before power fails."""
        if self.fuse is None:
            return size
        done = min(size, self.fuse)
        self.fuse -= size
        return done

    def _fail(self) -> None:
        if self.fuse is not None and self.fuse < 0:
            raise PowerFailedError

    def files(self, folder: str) -> list[str]:
        top = f"{folder}/" if folder else ""
        return sorted(path[len(top) :] for path in self.content if path.startswith(top))

    def read(self, path: str) -> bytes:
        if path not in self.content:
            raise FileNotFoundError(path)
        return self.content[path][0]

    def is_executable(self, path: str) -> bool:
        return self.content[path][1]

    def write(self, path: str, octets: bytes, *, executable: bool = False) -> None:
        if self._burn(1):
            self.content[path] = (b"", executable)
        self._fail()
        self.content[path] = (octets[: self._burn(len(octets))], executable)
        self._fail()

    def rename(self, old: str, new: str) -> None:
        if self._burn(1):
            for path in [each for each in self.content if (each + "/").startswith(old + "/")]:
                self.content[new + path[len(old) :]] = self.content.pop(path)
        self._fail()

    def remove(self, path: str) -> None:
        if path in self.content and self._burn(1):
            del self.content[path]
        self._fail()

    def powered_again(self) -> "FailingDisk":
        """The disk after power is back."""
        again = FailingDisk()
        again.content = dict(self.content)
        return again

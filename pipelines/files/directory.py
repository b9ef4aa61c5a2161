"""One directory on disk, beyond which nothing is read or written."""

import os
from pathlib import Path

from kontur_av.errors import ConfigError
from telepresence.files.entity import LARGEST_LISTING, STORE, DirectoryJob, fenced
from telepresence.files.pdus import GET, LIST, REMOVE, RENAME
from telepresence.files.receiver import MAX_FILE_OCTETS

_PART = ".part"
#: For the line that says how many are left out.
_ROOM = 40


class FencedDirectory:
    """Every method returns why it could not be done, "" if it was."""

    def __init__(self, root: Path) -> None:
        self._root = root.resolve()
        # What a killed process had begun to write.
        for part in self._root.rglob(f"{_PART}*"):
            part.unlink(missing_ok=True)

    def do(self, job: DirectoryJob) -> tuple[str, bytes]:
        """Do a job of the entity; the octets are those of a file or of a listing."""
        try:
            if job.kind == STORE:
                self._store(job.first, job.octets)
            elif job.kind == GET:
                return self.read(job.first)
            elif job.kind == LIST:
                return "", self._listing(job.first)
            elif job.kind == RENAME:
                self._rename(job.first, job.second)
            elif job.kind == REMOVE:
                self._file(job.first).unlink()
        except ConfigError as error:
            return str(error), b""
        except OSError as error:
            return (error.strerror or "not possible").lower(), b""
        return "", b""

    def read(self, name: str) -> tuple[str, bytes]:
        """Return why a file cannot be read, and its octets."""
        try:
            path = self._file(name)
            if path.stat().st_size > MAX_FILE_OCTETS:
                return f"{name}: more than {MAX_FILE_OCTETS} octets; send it in parts", b""
            return "", path.read_bytes()
        except ConfigError as error:
            return str(error), b""
        except OSError as error:
            return f"{name}: {(error.strerror or 'not possible').lower()}", b""

    def _path(self, name: str, *, directory: bool = False) -> Path:
        path = self._root.joinpath(*fenced(name, directory=directory))
        # A symbolic link in the directory may lead out of it.
        if not path.resolve().is_relative_to(self._root):
            raise ConfigError(f"{name}: outside of the directory")
        return path

    def _file(self, name: str) -> Path:
        path = self._path(name)
        if not path.is_file():
            raise ConfigError(f"{name}: no such file in {self._root.name}")
        return path

    def _store(self, name: str, octets: bytes) -> None:
        path = self._path(name)
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_name(f"{_PART}-{os.getpid()}")
        try:
            with part.open("wb") as file:
                file.write(octets)
                file.flush()
                os.fsync(file.fileno())
            # At once whole, or not there.
            part.replace(path)
        finally:
            part.unlink(missing_ok=True)

    def _rename(self, first: str, second: str) -> None:
        source, path = self._file(first), self._path(second)
        if path.exists():
            raise ConfigError(f"{second}: is there already")
        path.parent.mkdir(parents=True, exist_ok=True)
        source.rename(path)

    def _listing(self, name: str) -> bytes:
        """One line a file, with its octets in front; directories end with /."""
        listing, more = b"", 0
        for path in sorted(self._path(name, directory=True).iterdir()):
            if path.name.startswith("."):
                continue
            size = "" if path.is_dir() else str(path.stat().st_size)
            line = f"{size:>10} {path.name}{'/' if path.is_dir() else ''}\n"
            if len(listing) + len(line.encode(errors="replace")) > LARGEST_LISTING - _ROOM:
                more += 1
            else:
                listing += line.encode(errors="replace")
        return listing + (f"and {more} more\n".encode() if more else b"")

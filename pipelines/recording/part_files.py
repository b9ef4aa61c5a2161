"""The files of a recording's parts: written in one thread, handed to the disk in another. A shell.

So neither a slow disk nor a full one holds up the reader of the topics.
"""

import fcntl
import glob
import os
import shutil
import threading
from collections import deque
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from queue import SimpleQueue
from typing import TYPE_CHECKING, Literal, NamedTuple

from kontur_av.errors import ConfigError, ProtocolError, refused
from kontur_av.sources.spec import played_file
from pipelines.recording.metadata import RecordingMetadata
from pipelines.recording.recording_file import check_new, octets_of_file
from pipelines.recording.scan import first_capabilities
from pipelines.session.setup.table import Setup

if TYPE_CHECKING:
    # `record` checks a path, for which the codecs need not be loaded.
    from pipelines.recording.part_streams import PartPiece

_SYNC_S = 1.0
_MOST_PARTS = 100_000
_TRIAL = ".trial"
#: A recording without a known end has room for this long at its beginning.
LEAST_RECORDED_S = 60.0
#: Where nobody asks, all cameras are recorded if there is room for this long.
_ROOMY_S = 3600.0
#: Of a camera that is recorded whole: the most that three clips of real footage took.
_OCTETS_PER_PIXEL = 0.021


def part_path(path: Path, part: int) -> Path:
    """Return the name of a part's file: FILE.mcap, FILE-2.mcap, FILE-3.mcap, …"""
    return path if part == 1 else path.with_name(f"{path.stem}-{part}{path.suffix}")


def present_parts(path: Path) -> dict[int, Path]:
    """The files with names of this recording, by part, in order; some may be missing."""
    found = {1: path} if path.exists() else {}
    for other in path.parent.glob(f"{glob.escape(path.stem)}-*"):
        number = other.stem.removeprefix(f"{path.stem}-")
        if number.isdecimal() and int(number) > 1 and other == part_path(path, int(number)):
            found[int(number)] = other
    return dict(sorted(found.items()))


def check_recordable(path: Path, *, overwrite: bool, sources: Iterable[str] = ()) -> None:
    """Raise ConfigError unless a recording can begin at `path`; nothing is changed.

    sources: what the session captures, as SPECs. A file of these is not replaced.
    """
    for old in _old_parts(path):
        if _is_being_written(old):
            raise ConfigError(f"{old} is being recorded: record to another name")
    played = [file for spec in sources if (file := played_file(spec)) and file.exists()]
    for old in _old_parts(path):
        if any(old.samefile(file) for file in played):
            raise ConfigError(f"{old} is a source of this session: record to another name")
    for present in present_parts(path).values():
        check_new(present, overwrite=overwrite)
    trial = path.with_name(path.name + _TRIAL)
    with refused(f"{path} cannot be written"):
        with trial.open("wb"):
            pass
        trial.unlink()


class CameraRecording(NamedTuple):
    """choice: of the cameras, "all" or "carried". octets_per_s: that all of them need."""

    choice: Literal["all", "carried"]
    words: str
    octets_per_s: float


def recorded_cameras(path: Path, setup: Setup, asked: str = "") -> CameraRecording:
    """Decide which cameras a recording at `path` has. asked: "all", "carried", or "" for neither.

    Where neither asks for it, all are recorded if the disk has room for an hour.
    """
    asked = asked or setup.recorded_cameras
    streams = [setup.stream_of(name) for name in setup.inputs if setup.kind_of(name) == "video"]
    octets_per_s = sum(_OCTETS_PER_PIXEL * one.width * one.height * one.fps for one in streams)
    free = shutil.disk_usage(path.parent).free
    need = f"all {len(streams)} take up to {60 * octets_per_s / 1e6:.0f} MB a minute"
    fits = octets_per_s * _ROOMY_S <= free
    if asked == "all" or (asked == "auto" and fits):
        return CameraRecording("all", f"cameras at full rate: {need}", octets_per_s)
    words = f"cameras as carried, others at 5 Hz: {need}"
    if asked == "auto":
        words += f", and the disk has {free / 1e6:.0f} MB free (--record-cameras all)"
    return CameraRecording("carried", words, octets_per_s)


def check_disk(path: Path, cameras: CameraRecording, seconds: float) -> None:
    """Raise ConfigError if the disk of `path` has no room for all cameras for so many seconds.

    A recording without all cameras needs little, and is not checked.
    """
    need, free = cameras.octets_per_s * seconds, shutil.disk_usage(path.parent).free
    if cameras.choice == "all" and free < need:
        raise ConfigError(
            f"{path}: {cameras.words}, {need / 1e6:.0f} MB in {seconds:g} s, and the disk has "
            f"{free / 1e6:.0f} MB free: record to another disk, or with --record-cameras carried"
        )


def clear_parts(path: Path) -> None:
    """Remove an earlier recording of this name, after `check_recordable`; else ConfigError."""
    with refused(f"{path} cannot be replaced"):
        for old in _old_parts(path):
            old.unlink()


def _old_parts(path: Path) -> Iterator[Path]:
    """The file of this name, and later parts of the same session or without anything in them."""
    present = present_parts(path)
    if 1 not in present:
        return
    metadata = _capabilities_of(path)
    for old in present.values():
        found = _capabilities_of(old)
        same = metadata is not None and found is not None and found.is_of(metadata)
        if old == path or same or not old.stat().st_size:
            yield old


def _is_being_written(path: Path) -> bool:
    with suppress(OSError), path.open("rb") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            return True
    return False


def _capabilities_of(path: Path) -> RecordingMetadata | None:
    try:
        return first_capabilities(octets_of_file(path))
    except (ConfigError, ProtocolError):
        return None


class PartFiles:
    """The files of one recording.

    After `open` (in the caller's thread), `put` pieces; then `results` says what became of each.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._pieces: SimpleQueue[PartPiece | None] = SimpleQueue()
        self._results: deque[tuple[int, str]] = deque()
        #: How much was put and is not written yet.
        self.waiting_octets = 0
        self._lock = threading.Lock()
        #: By part: its open file. Only the writing thread closes one.
        self._files: dict[int, int] = {}
        #: By part: why the other thread found it lost.
        self._lost: dict[int, str] = {}
        #: By part: how much of it is whole, and whether messages are in it.
        self._whole: dict[int, int] = {}
        self._valuable: set[int] = set()
        self._ended = threading.Event()
        self._last = 0
        self._threads = [
            threading.Thread(target=run, daemon=True) for run in (self._write, self._sync)
        ]
        for thread in self._threads:
            thread.start()

    @property
    def newest(self) -> Path:
        return part_path(self._path, max(1, self._last))

    def open(self) -> int:
        """Create the file of the next part and return its number; OSError if that fails."""
        for part in range(self._last + 1, _MOST_PARTS):
            flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC
            try:
                file = os.open(part_path(self._path, part), flags, 0o600)
            except FileExistsError:
                continue
            fcntl.flock(file, fcntl.LOCK_EX)
            with self._lock:
                self._files[part] = file
                self._last = part
                self._whole[part] = 0
            return part
        raise OSError(f"{self._path} has too many parts")

    def put(self, piece: "PartPiece") -> None:
        """Write a piece as soon as the disk permits."""
        with self._lock:
            self.waiting_octets += len(piece.octets)
        self._pieces.put(piece)

    def results(self) -> Iterator[tuple[int, str]]:
        """Yield part and "" for each piece that was written, in order.

        For a part of which no more can be written: its number and why, once.
        """
        while self._results:
            yield self._results.popleft()

    def close(self, timeout_s: float) -> bool:
        """Write what was put, and close all files; False if the disk takes too long."""
        self._pieces.put(None)
        self._threads[0].join(timeout_s)
        self._ended.set()
        self._threads[1].join(timeout_s)
        return not any(thread.is_alive() for thread in self._threads)

    def _write(self) -> None:
        while (piece := self._pieces.get()) is not None:
            if piece.part in self._files:
                self._write_piece(piece)
            with self._lock:
                self.waiting_octets -= len(piece.octets)
        for part in list(self._files):
            self._forget(part)

    def _write_piece(self, piece: "PartPiece") -> None:
        part, file = piece.part, self._files[piece.part]
        try:
            if part in self._lost:
                raise OSError(0, self._lost[part])
            _write_all(file, piece.octets)
            self._whole[part] += len(piece.octets)
            if piece.messages:
                self._valuable.add(part)
            if piece.last:
                os.fdatasync(file)
        except OSError as error:
            self._fail(part, error.strerror or str(error))
            return
        self._results.append((part, ""))
        if piece.last:
            self._forget(part)

    def _sync(self) -> None:
        while not self._ended.wait(_SYNC_S):
            with self._lock:
                copies = {part: os.dup(file) for part, file in self._files.items()}
            for part, copy in copies.items():
                try:
                    os.fdatasync(copy)
                    if not os.fstat(copy).st_nlink:
                        self._lost[part] = "the file was removed"
                except OSError as error:
                    self._lost[part] = error.strerror or str(error)
                finally:
                    os.close(copy)

    def _fail(self, part: int, why: str) -> None:
        """No more is written of a part. Whole pieces stay; without a message it is removed."""
        with suppress(OSError):
            os.ftruncate(self._files[part], self._whole[part])
        if part not in self._valuable:
            with suppress(OSError):
                part_path(self._path, part).unlink()
            with self._lock:
                self._last = min(self._last, part - 1)
        self._forget(part)
        self._results.append((part, why))

    def _forget(self, part: int) -> None:
        with self._lock:
            file = self._files.pop(part)
        self._lost.pop(part, None)
        os.close(file)


def _write_all(file: int, octets: bytes) -> None:
    left = memoryview(octets)
    while left:
        left = left[os.write(file, left) :]

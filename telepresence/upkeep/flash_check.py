"""The flash driver's cyclic check: a few octets of the flash at a time, round and round. A core.

Its figures go into housekeeping.
"""

from binascii import crc32
from collections.abc import Mapping
from dataclasses import dataclass, replace

from telepresence.upkeep.file_store import FileStore
from telepresence.upkeep.sfv import SFV, parse_sfv


@dataclass(frozen=True, slots=True, kw_only=True)
class FlashFigures:
    """What housekeeping says of the flash."""

    #: Whole rounds through all files.
    rounds: int = 0
    #: Files that were checked.
    files_checked: int = 0
    #: Files whose checksum was wrong, or that could not be read.
    errors: int = 0
    #: What was wrong last; empty if nothing was.
    last_error: str = ""
    #: Whether the newest whole round was without an error.
    sound: bool = True


class FlashCheck:
    """Call `handle_time` at `poll_timeout`: it checks one file of the copy.

    interval_ns: from one file to the next.
    """

    def __init__(self, store: FileStore, folder: str, now_ns: int, interval_ns: int) -> None:
        self._store, self._folder, self._interval_ns = store, folder, interval_ns
        self._due_ns = now_ns
        self._left: dict[str, int] = {}
        self._wrong = False
        self.figures = FlashFigures()

    def poll_timeout(self) -> int:
        return self._due_ns

    def handle_time(self, now_ns: int) -> None:
        """Check the next file, if it is time."""
        if now_ns < self._due_ns:
            return
        self._due_ns = now_ns + self._interval_ns
        if not self._left:
            self._begin_round()
            return
        path, checksum = self._left.popitem()
        fault = self._fault(path, checksum)
        self.figures = replace(self.figures, files_checked=self.figures.files_checked + 1)
        if fault is not None:
            self._note(fault)
        if not self._left:
            self.figures = replace(
                self.figures, rounds=self.figures.rounds + 1, sound=not self._wrong
            )

    def _begin_round(self) -> None:
        self._wrong = False
        try:
            sums: Mapping[str, int] = parse_sfv(self._store.read(f"{self._folder}/{SFV}"))
        except (OSError, ValueError) as error:
            self._note(f"no list of checksums: {error}")
            self.figures = replace(self.figures, sound=False)
            return
        self._left = dict(sorted(sums.items(), reverse=True))

    def _fault(self, path: str, checksum: int) -> str | None:
        try:
            octets = self._store.read(f"{self._folder}/{path}")
        except OSError as error:
            return f"{path}: {error.strerror or error}"
        return None if crc32(octets) == checksum else f"{path}: damaged"

    def _note(self, fault: str) -> None:
        self._wrong = True
        self.figures = replace(self.figures, errors=self.figures.errors + 1, last_error=fault)

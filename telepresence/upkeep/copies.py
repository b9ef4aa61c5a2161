"""The copies of the joystick's software: what is written to which, and when it may be. A core.

At every instant one copy is whole: prime is written only while backup is valid, and the other way
round. The flash driver's cyclic check reads a few octets of the flash at a time, round and round;
its figures go into housekeeping.
"""

from binascii import crc32
from collections.abc import Mapping
from dataclasses import dataclass, replace

from kontur_av.errors import ConfigError
from telepresence.upkeep.app_loader import BootDevice, Copy, Mode
from telepresence.upkeep.file_store import FileStore, StoredFile, read_folder, replace_file
from telepresence.upkeep.manifest import RUN, SFV, fault_of, fault_of_files, parse_sfv, write_copy

_EEPROM, _WORKED = "eeprom", "worked"
#: Prime and backup by the device that was booted from.
PAIRS = {
    BootDevice.SD: (Copy.SD_1, Copy.SD_2),
    BootDevice.FLASH: (Copy.FTP_1, Copy.FTP_2),
}


def read_mode(store: FileStore) -> Mode | None:
    """Return the desired mode; None if it cannot be read."""
    try:
        return Mode(store.read(_EEPROM).decode(errors="replace").strip())
    except (OSError, ValueError):
        return None


def store_mode(store: FileStore, mode: Mode) -> None:
    if read_mode(store) is not mode:
        replace_file(store, _EEPROM, f"{mode.value}\n".encode())


def check_update(store: FileStore, files: Mapping[str, StoredFile], device: BootDevice) -> None:
    """Raise ConfigError unless an update may be written to prime: another copy must be whole."""
    backup = PAIRS[device][1]
    if RUN not in files or not files[RUN].executable:
        raise ConfigError(f"the update has no executable file {RUN!r}, which starts it")
    if SFV in files and (fault := fault_of_files(files)) is not None:
        raise ConfigError(f"the update is refused: {fault}")
    # Where neither is valid, there is nothing to lose.
    if (fault := fault_of(store, backup.value)) is not None and bootable(store, device):
        raise ConfigError(f"backup is invalid ({fault}): copy prime to backup first")


def update_prime(store: FileStore, files: Mapping[str, StoredFile], device: BootDevice) -> None:
    """Write an update to prime, to be tried next. ConfigError as of `check_update`."""
    check_update(store, files, device)
    prime = PAIRS[device][0]
    # If power fails meanwhile, prime is invalid, and this mode only names it.
    store_mode(store, Mode.PRIME)
    write_copy(store, prime.value, files)


def note_worked(store: FileStore, copy: Copy) -> None:
    """A copy has run without a malfunction: keep the CRC-32 of its list of checksums."""
    if (found := _edition(store, copy)) is not None and found != _worked(store):
        replace_file(store, _WORKED, f"{found:08X}\n".encode())


def copy_to_backup(store: FileStore, device: BootDevice) -> None:
    """Copy prime to backup. ConfigError if prime is not valid, or has not worked."""
    prime, backup = PAIRS[device]
    if (fault := fault_of(store, prime.value)) is not None:
        raise ConfigError(f"prime is invalid ({fault}), so backup stays as it is")
    if _edition(store, prime) != _worked(store):
        raise ConfigError("prime has not worked yet, so backup stays as it is: run it first")
    write_copy(store, backup.value, read_folder(store, prime.value))


def bootable(store: FileStore, device: BootDevice) -> list[Copy]:
    """The valid copies of a pair."""
    return [copy for copy in PAIRS[device] if fault_of(store, copy.value) is None]


def _edition(store: FileStore, copy: Copy) -> int | None:
    try:
        return crc32(store.read(f"{copy.value}/{SFV}"))
    except OSError:
        return None


def _worked(store: FileStore) -> int | None:
    try:
        return int(store.read(_WORKED), 16)
    except (OSError, ValueError):
        return None


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

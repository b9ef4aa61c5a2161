"""The copies of the joystick's software: what is written to which, and when it may be. A core.

At every instant one copy is whole: prime is written only while backup is valid, and the other way
round.
"""

from binascii import crc32
from collections.abc import Mapping

from kontur_av.errors import ConfigError
from telepresence.upkeep.app_loader import BootDevice, Copy, Mode
from telepresence.upkeep.file_store import FileStore, StoredFile, read_folder, replace_file
from telepresence.upkeep.manifest import RUN
from telepresence.upkeep.sfv import SFV, fault_of, fault_of_files, write_copy

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

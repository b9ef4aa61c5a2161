"""AppLoader of the joystick's computer: which copy of its software starts, and its copies. A core.

Stelzer et al., Figure 7. The desired mode is set to the *other* copy before one starts, so that a
machine that hangs and is switched on again tries the other one. Only an orderly shutdown makes the
mode that of the copy that ran.

At every instant one copy is whole: prime is written only while backup is valid, and the other way
round. The flash driver's cyclic check reads a few octets of the flash at a time, round and round;
its figures go into housekeeping.
"""

from binascii import crc32
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import Enum

from kontur_av.clock import NS_PER_S
from kontur_av.errors import ConfigError
from telepresence.upkeep.file_store import FileStore, StoredFile, read_listed, replace_file
from telepresence.upkeep.manifest import RUN, SFV, fault_of, fault_of_files, parse_sfv, write_copy

#: The time for an application to say that it has started.
START_NS = 30 * NS_PER_S
#: How long an application must run before its copy counts as one that works.
WORKED_NS = 60 * NS_PER_S
#: The wait before the copy of last resort is tried again, and how far it grows.
PAUSE_NS, LONGEST_PAUSE_NS = NS_PER_S, 60 * NS_PER_S


class Mode(Enum):
    """Which of two copies is wanted. The value is what the EEPROM has."""

    PRIME = "prime"
    BACKUP = "backup"

    @property
    def other(self) -> "Mode":
        return Mode.BACKUP if self is Mode.PRIME else Mode.PRIME


class BootDevice(Enum):
    """Where the kernel came from."""

    SD = "sd"
    FLASH = "flash"


class Copy(Enum):
    """A copy of the software. The value is its folder among the storages."""

    SD_1 = "sd/1"
    SD_2 = "sd/2"
    FTP_1 = "ftp/1"
    FTP_2 = "ftp/2"
    FLASH = "flash"


class LoaderStep(Enum):
    """What AppLoader waits for."""

    MODE = "desired mode"
    FTP = "FTP server"
    CHECK = "checks"
    STORE = "storing the mode"
    START = "start of the application"
    RUN = "running"
    STOP = "stop of the application"
    PAUSE = "pause"
    SHUTDOWN = "shutdown"
    OFF = "ready for power off"
    REBOOT = "reboot"


@dataclass(frozen=True, slots=True)
class LoadMode:
    """Read the desired mode from the EEPROM, then call `handle_mode`."""


@dataclass(frozen=True, slots=True)
class FindFtp:
    """See whether the FTP server has the folders, then call `handle_ftp`."""


@dataclass(frozen=True, slots=True)
class CheckCopy:
    """Verify a copy by its SFV file, then call `handle_checked`."""

    copy: Copy


@dataclass(frozen=True, slots=True)
class StoreMode:
    """Write the desired mode to the EEPROM, then call `handle_stored`."""

    mode: Mode


@dataclass(frozen=True, slots=True)
class StartApplication:
    """Start drivers and application, then call `handle_started` or `handle_malfunction`."""

    copy: Copy


@dataclass(frozen=True, slots=True)
class StopApplication:
    """End application and drivers, then call `handle_stopped`."""


@dataclass(frozen=True, slots=True)
class NoteWorked:
    """The application runs without a malfunction: its copy may be copied to backup."""

    copy: Copy


@dataclass(frozen=True, slots=True)
class RebootFromFlash:
    """Boot again, from flash."""


@dataclass(frozen=True, slots=True)
class PowerOffReady:
    """All is stopped and stored: power may go."""


@dataclass(frozen=True, slots=True)
class WriteUpdate:
    """All is stopped and stored: write the update to prime, then make another `AppLoader`."""


LoaderEvent = (
    LoadMode
    | FindFtp
    | CheckCopy
    | StoreMode
    | StartApplication
    | StopApplication
    | NoteWorked
    | RebootFromFlash
    | PowerOffReady
    | WriteUpdate
)


class AppLoader:
    """Begins at power on. Do each `next_event`, and answer it as its class says.

    Call `handle_time` at `poll_timeout`, `handle_malfunction` when the application fails before or
    after it has started, `handle_shutdown` when the user wants power off, and `handle_update` when
    prime is to be written. An answer that nobody waits for is ignored.

    step: what it waits for. copy: the one in use, if any. erroneous: copies out of use until the
    next power on, with the reason.
    """

    def __init__(self, device: BootDevice, now_ns: int) -> None:
        self.device = device
        self.step = LoaderStep.MODE
        self.copy: Copy | None = None
        self.desired = Mode.PRIME
        self.erroneous: dict[Copy, str] = {}
        self._events: deque[LoaderEvent] = deque([LoadMode()])
        #: Mode by copy that may be used; empty until they are checked.
        self._copies: dict[Copy, Mode] = {}
        self._unchecked: list[Copy] = []
        self._ends = self._updates = False
        self._due_ns: int | None = None
        self._pause_ns = PAUSE_NS
        self._now_ns = now_ns

    def next_event(self) -> LoaderEvent | None:
        """The next thing to do; None if there is nothing."""
        return self._events.popleft() if self._events else None

    def poll_timeout(self) -> int | None:
        """When to call `handle_time`; None if only answers are awaited."""
        return self._due_ns

    def handle_mode(self, mode: Mode | None, now_ns: int) -> None:
        """The desired mode; None if the EEPROM has none that can be read."""
        if not self._awaits(LoaderStep.MODE, now_ns):
            return
        self.desired = Mode.PRIME if mode is None else mode
        if self.device is BootDevice.SD:
            self._check(Copy.SD_1, Copy.SD_2)
        else:
            self.step = LoaderStep.FTP
            self._events.append(FindFtp())

    def handle_ftp(self, reachable: bool, now_ns: int) -> None:
        """Whether the FTP server has the folders."""
        if not self._awaits(LoaderStep.FTP, now_ns):
            return
        if reachable:
            self._check(Copy.FTP_1, Copy.FTP_2)
        else:
            self._use_flash()

    def handle_checked(self, copy: Copy, fault: str | None, now_ns: int) -> None:
        """A copy was verified. fault: what is wrong with it, None if nothing is."""
        if copy not in self._unchecked or not self._awaits(LoaderStep.CHECK, now_ns):
            return
        self._unchecked.remove(copy)
        if fault is not None:
            self.erroneous[copy] = fault
        if not self._unchecked:
            self._select()

    def handle_stored(self, now_ns: int) -> None:
        """The desired mode is in the EEPROM, or cannot be: the application starts in any case."""
        if not self._awaits(LoaderStep.STORE, now_ns):
            return
        if self._ends:
            self._off()
            return
        assert self.copy is not None
        self.step, self._due_ns = LoaderStep.START, now_ns + START_NS
        self._events.append(StartApplication(self.copy))

    def handle_started(self, now_ns: int) -> None:
        """The application says that it has started."""
        if self._awaits(LoaderStep.START, now_ns):
            self.step, self._due_ns = LoaderStep.RUN, now_ns + WORKED_NS
            self._pause_ns = PAUSE_NS

    def handle_malfunction(self, why: str, now_ns: int) -> None:
        """The application, or a driver, has failed."""
        if self.step not in (LoaderStep.START, LoaderStep.RUN):
            return
        assert self.copy is not None
        self._now_ns, self._due_ns = now_ns, None
        self.erroneous[self.copy] = why
        self.step = LoaderStep.STOP
        self._events.append(StopApplication())

    def handle_update(self, now_ns: int) -> None:
        """An update waits: end the application in good order, as before power off."""
        # Power off goes first.
        self._updates = not self._ends
        self._end(now_ns)

    def handle_shutdown(self, now_ns: int) -> None:
        """The user has ended the application in good order; power will go."""
        self._updates = False
        self._end(now_ns)

    def handle_stopped(self, now_ns: int) -> None:
        """Application and drivers have ended."""
        if self.step is LoaderStep.SHUTDOWN:
            assert self.copy is not None
            self._store(self._copies[self.copy])
        elif self.step is LoaderStep.STOP and self._ends:
            # This copy has failed: the mode stays that of the other one.
            self._off()
        elif self.step is LoaderStep.STOP:
            self._now_ns = now_ns
            self._select()

    def handle_time(self, now_ns: int) -> None:
        """An application that has not started in time has failed; a pause is over."""
        if self._due_ns is None or now_ns < self._due_ns:
            return
        if self.step is LoaderStep.PAUSE:
            self._now_ns, self._due_ns = now_ns, None
            self._use(Copy.FLASH)
        elif self.step is LoaderStep.RUN:
            assert self.copy is not None
            self._due_ns = None
            self._events.append(NoteWorked(self.copy))
        elif self.step is LoaderStep.START:
            self.handle_malfunction("it did not start in time", now_ns)

    def _end(self, now_ns: int) -> None:
        self._now_ns = now_ns
        if self.step in (LoaderStep.START, LoaderStep.RUN):
            self.step, self._due_ns = LoaderStep.SHUTDOWN, None
            self._events.append(StopApplication())
        elif self.step not in (
            LoaderStep.STOP,
            LoaderStep.SHUTDOWN,
            LoaderStep.OFF,
            LoaderStep.REBOOT,
        ):
            # Nothing runs yet, so the stored mode stays.
            self._events.clear()
            self._off()
        self._ends = True

    def _off(self) -> None:
        self.step, self._due_ns = LoaderStep.OFF, None
        self._events.append(WriteUpdate() if self._updates else PowerOffReady())

    def _awaits(self, step: LoaderStep, now_ns: int) -> bool:
        self._now_ns = now_ns
        return self.step is step

    def _check(self, prime: Copy, backup: Copy) -> None:
        self._copies = {prime: Mode.PRIME, backup: Mode.BACKUP}
        self._unchecked = [prime, backup]
        self.step = LoaderStep.CHECK
        self._events.extend(CheckCopy(copy) for copy in self._unchecked)

    def _select(self) -> None:
        """Choose among the copies without an error; it also follows a malfunction."""
        valid = [copy for copy in self._copies if copy not in self.erroneous]
        if len(valid) == 2:
            self._use(next(copy for copy in valid if self._copies[copy] is self.desired))
        elif valid:
            self._use(valid[0])
        elif self.device is BootDevice.SD:
            self.step, self.copy = LoaderStep.REBOOT, None
            self._events.append(RebootFromFlash())
        elif Copy.FLASH in self._copies:
            # Nothing comes after the last copy, so it is tried again, less and less often.
            self.step, self._due_ns = LoaderStep.PAUSE, self._now_ns + self._pause_ns
            self._pause_ns = min(2 * self._pause_ns, LONGEST_PAUSE_NS)
        else:
            self._use_flash()

    def _use_flash(self) -> None:
        # Not verified here: the boot loader has verified it with the kernel.
        self._copies = {Copy.FLASH: Mode.PRIME}
        self._use(Copy.FLASH)

    def _use(self, copy: Copy) -> None:
        self.copy = copy
        mode = self._copies[copy]
        alone = len([each for each in self._copies if each not in self.erroneous]) < 2
        self._store(mode if alone else mode.other)

    def _store(self, mode: Mode) -> None:
        self.desired, self.step = mode, LoaderStep.STORE
        self._events.append(StoreMode(mode))


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


def mode_words(store: FileStore) -> str:
    """The desired mode in words. Before the first start there is none: it begins with prime."""
    mode = read_mode(store)
    if mode is not None:
        return mode.value
    try:
        store.read(_EEPROM)
    except FileNotFoundError:
        return f"{Mode.PRIME.value}: it has not started yet"
    except OSError:
        pass
    return f"unreadable: {Mode.PRIME.value} is taken"


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
    write_copy(store, backup.value, read_listed(store, prime.value, SFV, parse_sfv))


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
class FlashMetrics:
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
        self.metrics = FlashMetrics()

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
        self.metrics = replace(self.metrics, files_checked=self.metrics.files_checked + 1)
        if fault is not None:
            self._note(fault)
        if not self._left:
            self.metrics = replace(
                self.metrics, rounds=self.metrics.rounds + 1, sound=not self._wrong
            )

    def _begin_round(self) -> None:
        self._wrong = False
        try:
            sums: Mapping[str, int] = parse_sfv(self._store.read(f"{self._folder}/{SFV}"))
        except (OSError, ValueError) as error:
            self._note(f"no list of checksums: {error}")
            self.metrics = replace(self.metrics, sound=False)
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
        self.metrics = replace(self.metrics, errors=self.metrics.errors + 1, last_error=fault)

"""Runs the joystick's software, of a copy that `AppLoader` chooses, and has copies by FTP.

A directory has the storages: `sd/1`, `sd/2`, `ftp/1`, `ftp/2`, `flash`, and the file `eeprom`.

Of what an FTP server sends, size and paths are checked. FTP has no protection of its own, so our
server listens on loopback unless told otherwise: updates up, log files down.
"""

import ftplib
import secrets
import time
from collections.abc import Callable, Mapping, Sequence
from functools import partial
from pathlib import Path
from urllib.parse import unquote, urlsplit

import msgspec

from kontur_av.clock import NS_PER_MS, NS_PER_S, MonotonicClock
from kontur_av.errors import ConfigError, refused
from pipelines.upkeep.requests import (
    DiskStore,
    InboxFolder,
    Program,
    answer_order,
    give_order,
    keeping,
    kept,
)
from telepresence.upkeep.app_loader import (
    PAIRS,
    AppLoader,
    BootDevice,
    CheckCopy,
    Copy,
    FindFtp,
    FlashCheck,
    FlashMetrics,
    LoaderEvent,
    LoadMode,
    NoteWorked,
    PowerOffReady,
    RebootFromFlash,
    StartApplication,
    StopApplication,
    StoreMode,
    WriteUpdate,
    check_update,
    copy_to_backup,
    mode_words,
    note_worked,
    read_mode,
    store_mode,
    update_prime,
)
from telepresence.upkeep.file_store import (
    FileStore,
    StoredFile,
    fill_folder,
    read_folder,
    replace_file,
)
from telepresence.upkeep.manifest import SFV, executables, fault_of, parse_sfv, write_copy
from telepresence.upkeep.version_stack import parse_status

_TIMEOUT_S = 10.0
_PORT = 21
_LARGEST_COPY = 1 << 28
_LARGEST_LIST = 1 << 20


def check_ftp_url(url: str) -> None:
    """Raise ConfigError unless this is the URL of an FTP server."""
    try:
        parts = urlsplit(url)
        fits = parts.scheme == "ftp" and parts.hostname and parts.port != 0
    except ValueError:
        fits = False
    if not fits:
        raise ConfigError(f"--ftp {url!r}: write ftp://USER:PASSWORD@HOST:PORT/")


def fetch_copies(url: str, store: FileStore, folders: dict[str, str]) -> bool:
    """Bring folders of a server into the store, unless they are there; whether it can be reached.

    folders: by the name on the server, the one in the store. A folder that cannot be fetched whole
    is invalid then, as its check shows.
    """
    parts = urlsplit(url)
    ftp = ftplib.FTP(timeout=_TIMEOUT_S)
    try:
        ftp.connect(parts.hostname or "", parts.port or _PORT)
        ftp.login(unquote(parts.username or "anonymous"), unquote(parts.password or ""))
    except (OSError, EOFError, ftplib.Error):
        ftp.close()
        return False
    top = parts.path.rstrip("/")
    try:
        for name, folder in folders.items():
            try:
                _fetch(ftp, f"{top}/{name}", store, folder)
            except (OSError, EOFError, ValueError, ftplib.Error):
                # Without its list the copy is invalid.
                store.remove(f"{folder}/{SFV}")
    finally:
        ftp.close()
    return True


def _fetch(ftp: ftplib.FTP, source: str, store: FileStore, folder: str) -> None:
    listed = _octets(ftp, f"{source}/{SFV}", _LARGEST_LIST)
    if fault_of(store, folder) is None and store.read(f"{folder}/{SFV}") == listed:
        return
    left, programs = _LARGEST_COPY, executables(listed)
    files = {SFV: StoredFile(listed)}
    for path in parse_sfv(listed):
        octets = _octets(ftp, f"{source}/{path}", left)
        left -= len(octets)
        files[path] = StoredFile(octets, executable=path in programs)
    fill_folder(store, folder, files, SFV)


def _octets(ftp: ftplib.FTP, path: str, most: int) -> bytes:
    parts: list[bytes] = []
    left = most

    def take(part: bytes) -> None:
        nonlocal left
        left -= len(part)
        if left < 0:
            raise ValueError(f"{path} is larger than {most} octets")
        parts.append(part)

    ftp.retrbinary(f"RETR {path}", take)
    return b"".join(parts)


USER = "kontur"
_POLL_S = 0.2
#: What may be done: change folder, list, read; append, delete, rename, make folders, store, chmod.
_RIGHTS = "elradfmwM"


def serve_ftp(
    folder: Path, address: tuple[str, int], say: Callable[[str], None], stopped: Callable[[], bool]
) -> None:
    """Serve the files below a folder to the user `kontur` until `stopped`."""
    try:
        from pyftpdlib.authorizers import DummyAuthorizer
        from pyftpdlib.handlers import FTPHandler
        from pyftpdlib.servers import FTPServer
    except ImportError:
        raise ConfigError(
            "the FTP server needs pyftpdlib: pip install 'kontur-av[upkeep]'"
        ) from None
    if not folder.is_dir():
        raise ConfigError(f"{folder} is no folder: `kontur-av apploader fill` makes one")
    password = secrets.token_urlsafe(12)
    authorizer = DummyAuthorizer()
    authorizer.add_user(USER, password, str(folder), perm=_RIGHTS)
    handler = type("Handler", (FTPHandler,), {"authorizer": authorizer, "banner": "kontur-av"})
    with refused(f"{address[0]}:{address[1]} cannot be used"):
        server = FTPServer(address, handler)
    server.max_cons, server.max_cons_per_ip = 16, 8
    host, port = server.address
    try:
        say(f"ftp://{USER}:{password}@{host}:{port}/")
        while not stopped():
            # `serve_forever` would say each time that it starts.
            server.ioloop.loop(_POLL_S, blocking=False)
    finally:
        server.close_all()


_POLL_NS = 100 * NS_PER_MS
_FLASH_NS = NS_PER_S
_HOUSEKEEPING_NS = 5 * NS_PER_S
_FTP_COPIES = PAIRS[BootDevice.FLASH]
_STATUS, _HOUSEKEEPING = ".status", "housekeeping.json"


class Housekeeping(msgspec.Struct, frozen=True, kw_only=True):
    """What the file `housekeeping.json` says of AppLoader and the flash."""

    device: str
    step: str
    copy: str | None
    desired_mode: str
    erroneous: dict[str, str]
    flash: FlashMetrics


class LoaderKeeper:
    """The storages of a joystick's computer in a directory. say: takes lines for people."""

    def __init__(self, path: Path, say: Callable[[str], None]) -> None:
        self.path, self._say = path, say
        self._now_ns = MonotonicClock().now_ns
        self.store = DiskStore(path)
        self._loader: AppLoader | None = None
        self._program = Program(path / _STATUS, ())
        self._over = False
        self._ftp: str | None = None
        self._device = BootDevice.SD
        #: What waits to be written to prime, and why that was not possible.
        self._update: Mapping[str, StoredFile] | None = None
        self._refusal = ""
        self._busy = False
        #: Copies out of use since the last update, also those before a reboot from flash.
        self._wrong: dict[Copy, str] = {}

    def fill(self, copy: Copy, folder: Path) -> None:
        """Write a copy as it was at delivery: any storage, also the flash."""
        self._refuse_while_running(f"{copy.value} is filled")
        write_copy(self.store, copy.value, read_folder(DiskStore(folder), ""))

    def update(self, folder: Path, device: BootDevice) -> None:
        """Write an update to prime. It may not lie in a storage itself."""
        self._refuse_while_running("prime is updated")
        update_prime(self.store, read_folder(DiskStore(folder), ""), device)

    def copy_to_backup(self, device: BootDevice) -> None:
        with kept(self.path) as free:
            if free:
                copy_to_backup(self.store, device)
            else:
                give_order(self.path, "copy")

    def shutdown(self) -> None:
        """Let the software that runs end in good order."""
        with kept(self.path) as free:
            if free:
                raise ConfigError(f"nothing runs in {self.path}")
        give_order(self.path, "shutdown")

    def _refuse_while_running(self, what: str) -> None:
        with kept(self.path) as free:
            if not free:
                raise ConfigError(f"{what} while nothing runs: `kontur-av apploader shutdown`")

    def run(
        self,
        device: BootDevice,
        arguments: Sequence[str],
        stopped: Callable[[], bool],
        ftp: str | None = None,
        inbox: Path | None = None,
    ) -> None:
        """Run until an orderly shutdown, as a signal is. ftp: the URL of the server, if any.

        inbox: a folder where updates and orders come as files.
        """
        if inbox is not None and ftp is not None:
            raise ConfigError("--inbox and --ftp: the server's copies would overwrite the update")
        with keeping(self.path):
            self._ftp, self._device = ftp, device
            self._program = Program(self.path / _STATUS, arguments)
            try:
                self._run(stopped, inbox)
            finally:
                self._program.stop()

    def _run(self, stopped: Callable[[], bool], inbox: Path | None) -> None:
        now_ns = self._now_ns
        self._loader = AppLoader(self._device, now_ns())
        box = None
        if inbox is not None:
            box = InboxFolder(inbox, ("copy",), add=self._take, order=self._obey)
        flash = FlashCheck(self.store, Copy.FLASH.value, now_ns(), _FLASH_NS)
        told_ns, told_step = now_ns(), None
        while not self._over:
            loader = self._work()
            if box is not None and not self._over:
                box.work(busy=self._busy, now_ns=now_ns())
                loader = self._work()
                box.publish(*self._summary(loader))
            if loader.step is not told_step or now_ns() >= told_ns:
                told_ns, told_step = now_ns() + _HOUSEKEEPING_NS, loader.step
                self._publish(loader, flash)
            if self._over:
                return
            time.sleep(_POLL_NS / NS_PER_S)
            if stopped():
                loader.handle_shutdown(now_ns())
            answer_order(self.path, partial(self._act, loader))
            code = self._program.exit_code()
            told = self._program.news()
            if told is not None:
                status = parse_status(told)
                self._busy = status is not None and status.busy
            if code == 0:
                loader.handle_shutdown(now_ns())
            elif code is not None:
                loader.handle_malfunction(f"it ended with {code}", now_ns())
            elif told is not None:
                loader.handle_started(now_ns())
            loader.handle_time(now_ns())
            flash.handle_time(now_ns())

    def _work(self) -> AppLoader:
        """Do all that is to be done; return the loader, which may be another one by then."""
        assert self._loader is not None
        while not self._over and (event := self._loader.next_event()) is not None:
            self._do(event, self._loader)
        return self._loader

    def _do(self, event: LoaderEvent, loader: AppLoader) -> None:
        store, now_ns = self.store, self._now_ns
        if isinstance(event, LoadMode):
            loader.handle_mode(read_mode(store), now_ns())
        elif isinstance(event, FindFtp):
            loader.handle_ftp(self._find_ftp(), now_ns())
        elif isinstance(event, CheckCopy):
            fault = fault_of(store, event.copy.value)
            if fault is not None:
                self._say(f"{event.copy.value} is invalid: {fault}")
            loader.handle_checked(event.copy, fault, now_ns())
        elif isinstance(event, StoreMode):
            store_mode(store, event.mode)
            loader.handle_stored(now_ns())
        elif isinstance(event, StartApplication):
            self._say(f"{event.copy.value} starts; desired mode {loader.desired.value}")
            if not self._program.start(self.path / event.copy.value):
                loader.handle_malfunction("it cannot be started", now_ns())
        elif isinstance(event, StopApplication):
            self._busy = False
            self._wrong |= loader.erroneous
            for copy, why in loader.erroneous.items():
                self._say(f"{copy.value} is out of use: {why}")
            self._program.stop()
            loader.handle_stopped(now_ns())
        elif isinstance(event, NoteWorked):
            note_worked(store, event.copy)
        elif isinstance(event, RebootFromFlash):
            self._say("no copy on the SD card is valid: reboot from flash")
            self._wrong |= loader.erroneous
            self._loader = AppLoader(BootDevice.FLASH, now_ns())
        elif isinstance(event, WriteUpdate):
            self._write_update()
            self._loader = AppLoader(self._device, now_ns())
        elif isinstance(event, PowerOffReady):
            self._say(f"ready for power off; desired mode {loader.desired.value}")
            self._over = True

    def _find_ftp(self) -> bool:
        """Whether the two folders are there, after they have been fetched if need be."""
        if self._ftp is not None:
            copies = {copy.value.rpartition("/")[2]: copy.value for copy in _FTP_COPIES}
            return fetch_copies(self._ftp, self.store, copies)
        return any(self.store.files(copy.value) for copy in _FTP_COPIES)

    def _take(self, name: str, files: Mapping[str, StoredFile]) -> str:
        """Write an update that came into the inbox to prime, and start it."""
        if SFV not in files:
            raise ConfigError(f"the update has no {SFV}: `kontur-av apploader sfv FOLDER`")
        check_update(self.store, files, self._device)
        self._say(f"update {name} waits: the software is ended")
        assert self._loader is not None
        self._update, self._refusal = files, ""
        self._loader.handle_update(self._now_ns())
        self._work()
        assert self._update is None
        if self._refusal:
            raise ConfigError(self._refusal)
        return f"written to {PAIRS[self._device][0].value}"

    def _write_update(self) -> None:
        assert self._update is not None
        self._wrong.clear()
        try:
            update_prime(self.store, self._update, self._device)
        except ConfigError as error:
            self._refusal = str(error)
        except OSError as error:
            self._refusal = f"the disk: {error.strerror or error}"
        self._update = None

    def _obey(self, order: str) -> str:
        assert self._loader is not None
        self._act(self._loader, order)
        return "done"

    def _summary(self, loader: AppLoader) -> tuple[str, str, dict[str, str]]:
        """What runs, what AppLoader does, and the copies with what is wrong with them."""
        wrong = {**self._wrong, **loader.erroneous}
        copies = dict.fromkeys((*PAIRS[self._device], *wrong))
        states = {copy.value: wrong.get(copy, "valid") for copy in copies}
        return "" if loader.copy is None else loader.copy.value, loader.step.value, states

    def _act(self, loader: AppLoader, order: str) -> None:
        if order == "copy":
            copy_to_backup(self.store, loader.device)
        elif order == "shutdown":
            loader.handle_shutdown(self._now_ns())
        else:
            raise ConfigError(f"no order is called {order!r}")

    def _publish(self, loader: AppLoader, flash: FlashCheck) -> None:
        told = Housekeeping(
            device=loader.device.value,
            step=loader.step.value,
            copy=None if loader.copy is None else loader.copy.value,
            desired_mode=loader.desired.value,
            erroneous={copy.value: why for copy, why in loader.erroneous.items()},
            flash=flash.metrics,
        )
        replace_file(self.store, _HOUSEKEEPING, msgspec.json.encode(told) + b"\n")


def list_lines(store: DiskStore) -> list[str]:
    """A line for each copy, and the desired mode."""
    lines = [f"desired mode  {mode_words(store)}"]
    for copy in Copy:
        if store.files(copy.value):
            fault = fault_of(store, copy.value)
            lines.append(f"{copy.value:<13} {'valid' if fault is None else f'invalid: {fault}'}")
    return lines

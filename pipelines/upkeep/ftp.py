"""FTP for the copies of the joystick's software: fetched from any server, or served here.

Of what a server sends, size and paths are checked. FTP has no protection of its own, so our server
listens on loopback unless told otherwise: updates up, log files down.
"""

import ftplib
import secrets
from collections.abc import Callable
from pathlib import Path
from urllib.parse import unquote, urlsplit

from kontur_av.errors import ConfigError, refused
from telepresence.upkeep.file_store import FileStore, StoredFile, fill_folder
from telepresence.upkeep.manifest import RUN, SFV, fault_of, parse_sfv

_PATIENCE_S = 10.0
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
    ftp = ftplib.FTP(timeout=_PATIENCE_S)
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
    left = _LARGEST_COPY
    files = {SFV: StoredFile(listed)}
    for path in parse_sfv(listed):
        octets = _octets(ftp, f"{source}/{path}", left)
        left -= len(octets)
        # FTP tells no modes.
        files[path] = StoredFile(octets, executable=path == RUN)
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
            server.serve_forever(timeout=_POLL_S, blocking=False, handle_exit=False)
    finally:
        server.close_all()

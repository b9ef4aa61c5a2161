"""The copies on an FTP server, which are fetched before they are checked.

The server may be any: size and paths of what it sends are checked.
"""

import ftplib
from urllib.parse import unquote, urlsplit

from kontur_av.errors import ConfigError
from telepresence.upkeep.file_store import FileStore, StoredFile, fill_folder
from telepresence.upkeep.manifest import RUN
from telepresence.upkeep.sfv import SFV, fault_of, parse_sfv

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

"""Reads the tar archive of an update. A core: nothing is unpacked to a disk.

Whoever sent it is a stranger until its checksums or its signature are verified, so all is bounded.
"""

import tarfile
import zlib
from io import BytesIO

from kontur_av.errors import ConfigError
from telepresence.upkeep.file_store import StoredFile, safe_path

#: Of the archive itself: no larger file comes across the link.
MOST_ARCHIVE_OCTETS = 16 << 20
_MOST_OCTETS, _MOST_FILES = 64 << 20, 1000
#: A zlib window of 32 KiB, in a gzip header.
_GZIP_BITS = 31
_GZIP = b"\x1f\x8b"
_EXECUTABLE = 0o100


def read_archive(octets: bytes) -> dict[str, StoredFile]:
    """Return the files of a tar archive, plain or compressed by gzip. Folders are left out.

    ConfigError, with the reason, if it is damaged, too large, or holds anything but files that
    stay within their folder.
    """
    files: dict[str, StoredFile] = {}
    try:
        with tarfile.open(fileobj=BytesIO(_plain(octets)), mode="r:") as archive:
            for number, member in enumerate(archive, 1):
                if number > _MOST_FILES:
                    raise ConfigError(f"the archive has more than {_MOST_FILES} files")
                _take(archive, member, files)
    except (tarfile.TarError, zlib.error, ValueError, OverflowError, EOFError) as error:
        raise ConfigError(f"no sound archive: {error}") from None
    folders = {path[:at] for path in files for at, letter in enumerate(path) if letter == "/"}
    for path in sorted(folders & files.keys()):
        raise ConfigError(f"the archive has {path!r} as a file and as a folder")
    return files


def _plain(octets: bytes) -> bytes:
    if len(octets) > MOST_ARCHIVE_OCTETS:
        raise ConfigError(f"the archive has more than {MOST_ARCHIVE_OCTETS} octets")
    if not octets.startswith(_GZIP):
        return octets
    unpacker = zlib.decompressobj(_GZIP_BITS)
    plain = unpacker.decompress(octets, _MOST_OCTETS + 1)
    if len(plain) > _MOST_OCTETS:
        raise ConfigError(f"the archive unpacks to more than {_MOST_OCTETS} octets")
    if not unpacker.eof:
        raise ConfigError("no sound archive: its end is missing")
    return plain


def _take(archive: tarfile.TarFile, member: tarfile.TarInfo, files: dict[str, StoredFile]) -> None:
    name = member.name.removeprefix("./")
    if member.isdir():
        return
    if not member.isreg() or member.issparse():
        raise ConfigError(f"the archive has {name!r}, which is no plain file")
    # What is not printable cannot stand in a list of checksums either.
    if not safe_path(name) or not name.isprintable() or name in files:
        raise ConfigError(f"the archive has the path {name!r}, or has it twice")
    content = archive.extractfile(member)
    assert content is not None
    files[name] = StoredFile(content.read(), executable=bool(member.mode & _EXECUTABLE))

"""Small files with secrets, which only their owner may read, or write."""

import os
from pathlib import Path
from stat import S_ISREG

from kontur_av.errors import ConfigError, refused

_LARGEST_FILE = 65536
_MOST_SECRET_OCTETS = 4096
#: Bits of a file's mode: others may use it at all, or write it.
OTHERS, OTHERS_WRITE = 0o077, 0o022


def read_private(path: Path, forbidden: int = OTHERS) -> bytes | None:
    """Return the octets of a small file; None if it is not there.

    forbidden: bits of its mode that must not be set, `OTHERS` or `OTHERS_WRITE`.

    Raises ConfigError, which never quotes the file, if it is open to others or cannot be read.
    """
    try:
        # Without O_NONBLOCK a FIFO would wait for a writer.
        descriptor = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
        # Of the opened file, because the name may have been given to another meanwhile.
        state = os.fstat(descriptor)
        if not S_ISREG(state.st_mode):
            os.close(descriptor)
            raise ConfigError(f"{path} is no file: give the file of a key")
        with os.fdopen(descriptor, "rb") as file:
            if state.st_uid not in (os.geteuid(), 0):
                raise ConfigError(f"{path} belongs to another user: use a key of your own")
            if state.st_mode & forbidden:
                fix = "chmod 600" if forbidden == OTHERS else "chmod go-w"
                raise ConfigError(f"{path} is open to other users: {fix} {path}")
            return file.read(_LARGEST_FILE)
    except FileNotFoundError:
        return None
    except OSError as error:
        raise ConfigError(f"{path} cannot be read: {error.strerror}") from None


def read_secret(path: Path, option: str) -> str:
    """Return the text of a file that holds a secret; ConfigError if it has none."""
    with refused(f"{option} {str(path)!r} cannot be read"):
        octets = path.read_bytes()[: _MOST_SECRET_OCTETS + 1]
    if len(octets) > _MOST_SECRET_OCTETS:
        raise ConfigError(f"{option} {str(path)!r} is longer than {_MOST_SECRET_OCTETS} octets")
    text = octets.decode("utf-8", "replace").strip()
    if not text:
        raise ConfigError(f"{option} {str(path)!r} is empty")
    return text

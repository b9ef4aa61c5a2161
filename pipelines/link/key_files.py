"""Key files: this machine's private key, and beside it the identities that it trusts.

The private key is PEM in a file of mode 0600. The trusted identities are lines of text in the file
of the same name with `.trusted` at its end.
"""

import os
import secrets
from collections.abc import Sequence
from pathlib import Path

from kontur_av.errors import ConfigError, refused
from telepresence.link.protection.identity import MachineIdentity, MachineKey
from telepresence.private_file import OTHERS_WRITE, read_private

_SEED_OCTETS = 32
_TRUSTED = ".trusted"
_HEAD = "# Identities that this machine trusts: `kontur-av keys trust` and `keys forget`.\n"


def default_key_path() -> Path:
    """Return where the key lies: in the configuration directory (XDG Base Directory 0.8).

    Raises ConfigError for a user without a home directory, as in some containers.
    """
    configured = Path(os.environ.get("XDG_CONFIG_HOME", ""))
    try:
        # The specification: a relative path is to be ignored.
        room = configured if configured.is_absolute() else Path.home() / ".config"
    except RuntimeError:
        raise ConfigError("you have no home directory: set HOME, or give --key FILE") from None
    return room / "kontur-av" / "key.pem"


def trusted_path(key_path: Path) -> Path:
    """Return the file of the identities that the key's owner trusts."""
    return key_path.with_name(key_path.name + _TRUSTED)


def make_key(path: Path) -> MachineKey:
    """Write a new key to the new file `path`, for its owner only.

    Raises ConfigError if the file exists, or cannot be written.
    """
    key = MachineKey.from_seed(secrets.token_bytes(_SEED_OCTETS))
    try:
        path.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
        descriptor = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL | os.O_CLOEXEC, 0o600)
    except OSError as error:
        # The error is also that of a directory whose name a file has.
        if isinstance(error, FileExistsError) and path.parent.is_dir():
            raise ConfigError(
                f"{path} exists: a new key is a new identity, so remove this one first"
            ) from None
        raise ConfigError(f"{path} cannot be written: {error.strerror}") from None
    try:
        with os.fdopen(descriptor, "wb") as file:
            file.write(key.to_pem())
            file.flush()
            os.fsync(file.fileno())
    except OSError as error:
        path.unlink(missing_ok=True)
        raise ConfigError(f"{path} cannot be written: {error.strerror}") from None
    return key


def read_key(path: Path) -> MachineKey:
    """Return the key in a file.

    Raises ConfigError, which never quotes the file, if there is none, or if others may read it.
    """
    octets = read_private(path)
    if octets is None:
        raise ConfigError(f"there is no key {path}: `kontur-av keys new` makes one")
    try:
        return MachineKey.from_pem(octets)
    except ValueError as error:
        raise ConfigError(f"{path} has {error}: `kontur-av keys new` makes one that fits") from None


def trusted_identities(key_path: Path) -> list[MachineIdentity]:
    """Return the identities that the owner of a key trusts, in the order of the file."""
    path = trusted_path(key_path)
    octets = read_private(path, OTHERS_WRITE)
    found = []
    for number, line in enumerate((octets or b"").decode(errors="replace").splitlines(), 1):
        text = line.partition("#")[0].strip()
        if not text:
            continue
        with refused(f"{path}, line {number}", ConfigError):
            found.append(MachineIdentity.parse(text))
    return found


def trust(key_path: Path, identity: MachineIdentity) -> bool:
    """Add an identity to those trusted; whether it is new. ConfigError if it is this machine's."""
    if read_key(key_path).identity == identity:
        raise ConfigError("this is the identity of this machine: trust that of the other one")
    known = trusted_identities(key_path)
    if identity in known:
        return False
    _write_trusted(key_path, [*known, identity])
    return True


def forget(key_path: Path, identity: MachineIdentity) -> None:
    """Trust an identity no more; ConfigError if it was not trusted."""
    known = trusted_identities(key_path)
    if identity not in known:
        raise ConfigError(f"{identity} is not trusted: `kontur-av keys list` shows who is")
    _write_trusted(key_path, [each for each in known if each != identity])


def pinned_peer(key_path: Path, chosen: str | None) -> MachineIdentity:
    """Return the one identity that the other end must prove.

    chosen: an identity that the user named; it must be trusted. Without it exactly one may be.
    """
    known = trusted_identities(key_path)
    if not known:
        raise ConfigError(
            f"{key_path} trusts nobody: `kontur-av keys trust IDENTITY`, with the line that "
            "`keys show` prints on the other machine"
        )
    if chosen is not None:
        identity = MachineIdentity.parse(chosen)
        if identity not in known:
            raise ConfigError(f"{identity} is not trusted: `kontur-av keys trust {identity}`")
        return identity
    if len(known) > 1:
        raise ConfigError(
            f"{key_path} trusts {len(known)} identities: name the peer's by --identity, "
            "or `kontur-av keys forget` the others"
        )
    return known[0]


def _write_trusted(key_path: Path, identities: Sequence[MachineIdentity]) -> None:
    path = trusted_path(key_path)
    unfinished = path.with_name(f"{path.name}.{os.getpid()}")
    with refused(f"{path} cannot be written"):
        try:
            descriptor = os.open(
                unfinished, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_CLOEXEC, 0o600
            )
            with os.fdopen(descriptor, "w", encoding="ascii") as file:
                file.write(_HEAD + "".join(f"{identity}\n" for identity in identities))
                file.flush()
                os.fsync(file.fileno())
            unfinished.replace(path)
        finally:
            unfinished.unlink(missing_ok=True)

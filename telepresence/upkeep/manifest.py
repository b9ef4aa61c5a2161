"""Lists of files with checksums: of a version, signed, and of a copy by CRC-32. A core.

The manifest of a version has SHA-256, and is signed by a machine's key: Ed25519 (RFC 8032) over
name and files, as JSON with sorted keys. A copy has Simple File Verification: CRC-32, as cksfv
reads it.
"""

import re
from binascii import crc32
from collections.abc import Collection, Mapping
from hashlib import sha256

import msgspec
from cryptography.exceptions import InvalidSignature
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PublicKey
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

from kontur_av.errors import ConfigError
from telepresence.link.protection.identity import MachineIdentity, MachineKey
from telepresence.malformed import MALFORMED
from telepresence.upkeep.file_store import (
    FileStore,
    StoredFile,
    fill_folder,
    read_listed,
    safe_path,
)

#: The list in each copy of the software.
SFV = "files.sfv"
#: Our own lines, comments for others: FTP tells no modes.
_EXECUTABLE = "; executable: "
_LINE = re.compile(r"(.*\S)\s+([0-9A-Fa-f]{8})")


def sfv_text(files: Mapping[str, StoredFile]) -> bytes:
    """Return the list of these files, whose paths are safe ones."""
    lines = ["; Checksums (CRC-32) of this copy; cksfv verifies them.\n"]
    for path, file in sorted(files.items()):
        if file.executable:
            lines.append(f"{_EXECUTABLE}{path}\n")
        lines.append(f"{path} {crc32(file.octets):08X}\n")
    return "".join(lines).encode()


def parse_sfv(octets: bytes) -> dict[str, int]:
    """Return CRC-32 by path. Raises ValueError if the list is damaged."""
    sums = {}
    for line in octets.decode(errors="strict").splitlines():
        if not line.strip() or line.startswith(";"):
            continue
        found = _LINE.fullmatch(line.strip())
        if found is None or not safe_path(found[1]):
            raise ValueError(f"its list of checksums has the line {line[:80]!r}")
        sums[found[1]] = int(found[2], 16)
    if not sums:
        raise ValueError("its list of checksums is empty")
    return sums


def executables(octets: bytes) -> set[str]:
    """Return which files of a sound list are programs; `RUN` always is."""
    marked = octets.decode().split(f"\n{_EXECUTABLE}")[1:]
    return {RUN, *(after.partition("\n")[0] for after in marked)}


def fault_of_files(files: Mapping[str, StoredFile]) -> str | None:
    """Return what is wrong with a copy, None if nothing is. Files without a line do not matter."""
    if SFV not in files:
        return "it has no list of checksums"
    try:
        sums = parse_sfv(files[SFV].octets)
    except ValueError as error:
        return str(error)
    for path, checksum in sums.items():
        if path not in files:
            return f"its file {path} is missing"
        if crc32(files[path].octets) != checksum:
            return f"its file {path} is damaged"
    return None


def fault_of(store: FileStore, folder: str) -> str | None:
    """Return what is wrong with the copy in a folder, None if nothing is."""
    try:
        return fault_of_files(read_listed(store, folder, SFV, parse_sfv))
    except OSError as error:
        return f"it cannot be read: {error.strerror or error}"
    except ValueError as error:
        return str(error)


def write_copy(store: FileStore, folder: str, files: Mapping[str, StoredFile]) -> None:
    """Make a folder a copy of these files. While it is written it is invalid, by its list."""
    bare = {path: file for path, file in files.items() if path != SFV}
    listed = {**bare, SFV: StoredFile(sfv_text(bare))}
    fill_folder(store, folder, listed, SFV)


#: The manifest's file in a version's folder, and the program that starts it.
MANIFEST, RUN = "manifest.json", "run"
_LARGEST_MANIFEST = 1 << 20


class Manifest(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """files: SHA-256 by path, as hexadecimal digits. key, signature: of who signed, likewise."""

    version: str
    files: dict[str, str]
    key: str
    signature: str


def signed_manifest(version: str, files: Mapping[str, StoredFile], key: MachineKey) -> bytes:
    """Return the manifest of these files. Raises ConfigError if they are no version."""
    if RUN not in files or not files[RUN].executable:
        raise ConfigError(f"version {version} has no executable file {RUN!r}, which starts it")
    sums = _sums(files)
    public = key.private.public_key().public_bytes(Encoding.Raw, PublicFormat.Raw)
    signature = key.private.sign(_signed(version, sums))
    manifest = Manifest(version=version, files=sums, key=public.hex(), signature=signature.hex())
    octets = msgspec.json.format(msgspec.json.encode(manifest, order="sorted"), indent=1) + b"\n"
    if len(octets) > _LARGEST_MANIFEST:
        raise ConfigError(f"version {version} has too many files: its manifest is above 1 MB")
    return octets


def signer(octets: bytes) -> tuple[Manifest, MachineIdentity]:
    """Return a manifest and who signed it. Raises ValueError if it is damaged or forged."""
    if len(octets) > _LARGEST_MANIFEST:
        raise ValueError("its manifest is larger than 1 MB")
    try:
        manifest = msgspec.json.decode(octets, type=Manifest)
        public = Ed25519PublicKey.from_public_bytes(bytes.fromhex(manifest.key))
        public.verify(bytes.fromhex(manifest.signature), _signed(manifest.version, manifest.files))
    except (ValueError, InvalidSignature, *MALFORMED):
        raise ValueError("its manifest is damaged, or its signature does not fit") from None
    if RUN not in manifest.files or not all(map(safe_path, manifest.files)):
        raise ValueError("its manifest names paths that are no version's")
    return manifest, MachineIdentity.of(public)


def check_version(
    files: Mapping[str, StoredFile], version: str, trusted: Collection[MachineIdentity]
) -> None:
    """Raise ValueError, with the reason, unless these are the files that a trusted one signed."""
    if MANIFEST not in files:
        raise ValueError("it has no manifest")
    manifest, identity = signer(files[MANIFEST].octets)
    if identity not in trusted:
        raise ValueError(f"it is signed by {identity}, which is not trusted")
    if manifest.version != version:
        raise ValueError(f"its manifest is that of version {manifest.version}")
    sums = _sums(files)
    for path in sorted(sums.keys() ^ manifest.files.keys()):
        raise ValueError(f"its file {path} is {'extra' if path in sums else 'missing'}")
    for path, digest in manifest.files.items():
        if sums[path] != digest:
            raise ValueError(f"its file {path} is damaged")
    if not files[RUN].executable:
        raise ValueError(f"its file {RUN} is not executable")


def _sums(files: Mapping[str, StoredFile]) -> dict[str, str]:
    return {
        path: sha256(file.octets).hexdigest() for path, file in files.items() if path != MANIFEST
    }


def _signed(version: str, files: Mapping[str, str]) -> bytes:
    return msgspec.json.encode({"version": version, "files": files}, order="sorted")

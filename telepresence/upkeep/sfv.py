"""Simple File Verification: a list of files with their CRC-32, as cksfv has it. A core.

A line is a path and eight hexadecimal digits; lines that begin with `;` are comments.
"""

import re
from binascii import crc32
from collections.abc import Mapping

from telepresence.upkeep.file_store import (
    FileStore,
    StoredFile,
    fill_folder,
    read_folder,
    safe_path,
)

#: The list in each copy of the software.
SFV = "files.sfv"
_LINE = re.compile(r"(.*\S)\s+([0-9A-Fa-f]{8})")


def sfv_text(files: Mapping[str, StoredFile]) -> bytes:
    """Return the list of these files. Raises ValueError for a path that no line can hold."""
    lines = ["; Checksums (CRC-32) of this copy; cksfv verifies them.\n"]
    for path, file in sorted(files.items()):
        line = f"{path} {crc32(file.octets):08X}"
        found = _LINE.fullmatch(line)
        if found is None or found[1] != path or path.startswith(";"):
            raise ValueError(f"{path!r} cannot stand in a list of checksums: rename the file")
        lines.append(f"{line}\n")
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
        return fault_of_files(read_folder(store, folder))
    except OSError as error:
        return f"it cannot be read: {error.strerror or error}"


def write_copy(store: FileStore, folder: str, files: Mapping[str, StoredFile]) -> None:
    """Make a folder a copy of these files. While it is written it is invalid, by its list."""
    bare = {path: file for path, file in files.items() if path != SFV}
    listed = {**bare, SFV: StoredFile(sfv_text(bare))}
    fill_folder(store, folder, listed, SFV)

"""A directory of versions: their folders, and one file that has their states. A core.

That file is the pointer, and it is replaced at once. A version's folder has its name only when it
is whole. So power may fail at any instant.
"""

import re
from collections.abc import Collection, Mapping

import msgspec

from kontur_av.errors import ConfigError
from telepresence.link.protection.identity import MachineIdentity
from telepresence.malformed import MALFORMED
from telepresence.upkeep.file_store import (
    UNFINISHED,
    FileStore,
    StoredFile,
    read_folder,
    replace_file,
)
from telepresence.upkeep.manifest import MANIFEST, check_version
from telepresence.upkeep.version_stack import ELEMENTARY, StackRecord, VersionState

#: The file with the record of the stack.
STACK = "stack.json"
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_+-]*(\.[A-Za-z0-9_+-]+)*")


class VersionDirectory:
    """The versions of one end. trusted: who may sign them."""

    def __init__(self, store: FileStore, trusted: Collection[MachineIdentity]) -> None:
        self._store, self._trusted = store, trusted

    def read(self) -> StackRecord:
        """Return the record; without a readable one, all whole versions, with none on trial."""
        try:
            return msgspec.json.decode(self._store.read(STACK), type=StackRecord)
        except (OSError, *MALFORMED):
            paths = self._store.files("")
            found = sorted({path.split("/")[0] for path in paths if path.count("/") == 1})
            versions = tuple(
                (name, VersionState.NEW)
                for name in found
                if name != ELEMENTARY and _is_name(name) and f"{name}/{MANIFEST}" in paths
            )
            return StackRecord(versions=versions)

    def store(self, record: StackRecord) -> None:
        replace_file(self._store, STACK, msgspec.json.encode(record) + b"\n")

    def check(self, name: str) -> None:
        """Raise ValueError, with the reason, unless a version is whole and signed."""
        try:
            files = read_folder(self._store, name)
        except OSError as error:
            raise ValueError(f"it cannot be read: {error.strerror or error}") from None
        check_version(files, name, self._trusted)

    def add(self, name: str, files: Mapping[str, StoredFile]) -> None:
        """Keep the files of a version, with its manifest. Raises ConfigError if they are not its.

        It is no version of the stack before its record has it (`StackRecord.added`).
        """
        if not _is_name(name):
            raise ConfigError(f"version {name!r}: use letters, digits and . _ + - in its name")
        try:
            check_version(files, name, self._trusted)
        except ValueError as error:
            raise ConfigError(f"version {name} is refused: {error}") from None
        if STACK not in self._store.files(""):
            # Without a record the new folder would be taken for a version of an older one.
            self.store(self.read())
        unfinished = name + UNFINISHED
        self.forget(unfinished)
        # A folder of this name is in no record.
        self.forget(name)
        for path, file in files.items():
            self._store.write(f"{unfinished}/{path}", file.octets, executable=file.executable)
        self._store.rename(unfinished, name)

    def holds(self, name: str, files: Mapping[str, StoredFile], record: StackRecord) -> bool:
        """Whether a version is here already, as one that came twice.

        It may have ended the link the first time, before its sender knew.
        """
        if record.state(name) is None or MANIFEST not in files:
            return False
        try:
            return self._store.read(f"{name}/{MANIFEST}") == files[MANIFEST].octets
        except OSError:
            return False

    def has_elementary(self) -> bool:
        return f"{ELEMENTARY}/{MANIFEST}" in self._store.files("")

    def forget(self, name: str) -> None:
        """Remove the files of a version that no record has any more."""
        for path in self._store.files(name):
            self._store.remove(f"{name}/{path}")

    def tidy(self) -> None:
        """Remove what a power cut left behind."""
        for path in self._store.files(""):
            if UNFINISHED in path.split("/")[0]:
                self._store.remove(path)


def _is_name(name: str) -> bool:
    return _NAME.fullmatch(name) is not None and not name.endswith(UNFINISHED) and name != STACK

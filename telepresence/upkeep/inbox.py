"""Updates and orders that come as files: which is taken when, and what became of each. A core.

An archive is `NAME.tar` or `NAME.tar.gz`. An order is a text of one line in a file `NAME.order`.
Archives are read in memory and never unpacked to a disk. The sender is not trusted until checksums
or signature are verified, so sizes are bounded.
"""

import tarfile
import zlib
from collections import OrderedDict, deque
from collections.abc import Collection, Mapping
from io import BytesIO
from typing import NamedTuple

import msgspec

from kontur_av.clock import NS_PER_S
from kontur_av.errors import ConfigError
from telepresence.malformed import MALFORMED
from telepresence.upkeep.file_store import StoredFile, safe_path

#: Of the archive itself: no larger file comes across the link.
MOST_ARCHIVE_OCTETS = 16 << 20
_MOST_OCTETS, _MOST_FILES = 64 << 20, 1000
#: A zlib window of 32 KiB, in a gzip header.
_GZIP_BITS = 31
_GZIP = b"\x1f\x8b"
_EXECUTABLE = 0o100


def read_archive(octets: bytes) -> dict[str, StoredFile]:
    """Return the files of a tar archive, plain or compressed by gzip.

    ConfigError, with the reason, if it is damaged, too large, or holds anything but files that
    stay within their folder.
    """
    files: dict[str, StoredFile] = {}
    named = set()
    try:
        with tarfile.open(fileobj=BytesIO(_plain(octets)), mode="r:") as archive:
            for number, member in enumerate(archive, 1):
                if number > _MOST_FILES:
                    raise ConfigError(f"the archive has more than {_MOST_FILES} files")
                if member.isdir():
                    named.add(member.name.removeprefix("./"))
                else:
                    _take(archive, member, files)
    except ConfigError:
        raise
    except Exception as error:
        # Also RecursionError: each long name in a row costs tarfile some frames of its stack.
        raise ConfigError(f"no sound archive: {error}") from None
    folders = {path[:at] for path in files for at, letter in enumerate(path) if letter == "/"}
    for path in sorted(folders & files.keys()):
        raise ConfigError(f"the archive has {path!r} as a file and as a folder")
    for path in sorted(named - folders - {".", ""}):
        raise ConfigError(f"the archive has the empty folder {path!r}: put a file into it")
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
    if not member.isreg() or member.issparse():
        raise ConfigError(f"the archive has {name!r}, which is no plain file")
    if not safe_path(name) or name in files:
        raise ConfigError(f"the archive has the path {name!r}, or has it twice")
    content = archive.extractfile(member)
    assert content is not None
    files[name] = StoredFile(content.read(), executable=bool(member.mode & _EXECUTABLE))


#: How long a file must lie still. By then its sender knows that it has arrived, though the update
#: may end the link.
REST_NS = 5 * NS_PER_S
#: What the keeper tells, in the inbox itself.
TOLD = "upkeep.json"
LARGEST_TOLD = 64 << 10
TAKEN, REFUSED = ".taken", ".refused"
_ARCHIVES, _ORDER = (".tar", ".tar.gz"), ".order"
_MOST_ANSWERS = 16
_LARGEST_ORDER, _LARGEST_TEXT = 200, 300


class FileStamp(NamedTuple):
    """By which a file is known to be the same."""

    written_ns: int
    number: int
    octets: int


class InboxAnswer(msgspec.Struct, frozen=True, kw_only=True):
    """What became of a file; text: of a refusal the reason."""

    file: str
    taken: bool
    text: str


class InboxTold(msgspec.Struct, frozen=True, kw_only=True):
    """What the file `TOLD` says.

    runs: the version or the copy. why: it runs. states: by version or copy. waiting: files that are
    not taken yet. busy: an experiment runs, so nothing is taken.
    """

    runs: str
    why: str
    states: dict[str, str]
    waiting: tuple[str, ...] = ()
    busy: bool = False
    answers: tuple[InboxAnswer, ...] = ()


class UpdateInbox:
    """Tell it the files that lie there and whether an experiment runs.

    Take the file of each `next_file`, answer by `handle_done`, and give the file its new name.

    words: the orders that are allowed. told: what was told before the keeper was started again.
    """

    def __init__(self, words: Collection[str], told: bytes = b"") -> None:
        self._words = words
        self._answers = deque(_answers_of(told), maxlen=_MOST_ANSWERS)
        #: Stamp of each file, and since when it is so.
        self._there: OrderedDict[str, tuple[FileStamp, int]] = OrderedDict()
        #: Those that are done, in case they cannot be renamed.
        self._done: dict[str, FileStamp] = {}
        self._busy = False

    def handle_files(self, files: Mapping[str, FileStamp], now_ns: int) -> None:
        """All files of the folder; the inbox ignores those that are not for it."""
        before, self._there = self._there, OrderedDict()
        self._done = {name: stamp for name, stamp in self._done.items() if name in files}
        for name, stamp in sorted(files.items(), key=lambda one: (one[1], one[0])):
            if (version_of(name) or is_order(name)) and self._done.get(name) != stamp:
                seen = before.get(name)
                self._there[name] = (
                    seen if seen is not None and seen[0] == stamp else (stamp, now_ns)
                )

    def handle_busy(self, busy: bool) -> None:
        """Whether an experiment runs, or the running program does not want to be stopped."""
        self._busy = busy

    def next_file(self, now_ns: int) -> str | None:
        """Return the file to take now, the oldest first; None if there is none."""
        if self._busy:
            return None
        rested = (n for n, (_, since_ns) in self._there.items() if now_ns - since_ns >= REST_NS)
        return next(rested, None)

    def order_of(self, octets: bytes) -> str:
        """Return the order in a file. ConfigError for any other text."""
        text = octets[: _LARGEST_ORDER + 1].decode(errors="replace").strip()
        if not text or text.split()[0] not in self._words or len(text) > _LARGEST_ORDER:
            allowed = ", ".join(sorted(self._words))
            raise ConfigError(f"no order {text[:40]!r}: one line with {allowed}, and a name")
        return " ".join(text.split())

    def handle_done(self, name: str, text: str, refusal: str) -> str:
        """A file was taken, or refused with this reason. Return the new name of the file."""
        if (seen := self._there.pop(name, None)) is not None:
            self._done[name] = seen[0]
        said = (refusal or text)[:_LARGEST_TEXT]
        self._answers.append(InboxAnswer(file=name, taken=not refusal, text=said))
        return name + (REFUSED if refusal else TAKEN)

    def told(self, runs: str, why: str, states: Mapping[str, str]) -> bytes:
        """Return what the file `TOLD` is to have."""
        told = InboxTold(
            runs=runs,
            why=why,
            states=dict(states),
            waiting=tuple(self._there),
            busy=self._busy,
            answers=tuple(self._answers),
        )
        return msgspec.json.format(msgspec.json.encode(told), indent=1) + b"\n"


def version_of(name: str) -> str:
    """Return the version that an archive is called after; "" if the file is no archive."""
    ending = next((archive for archive in _ARCHIVES if name.endswith(archive)), "")
    odd = name.startswith(".") or not name.isprintable()
    return "" if not ending or odd else name.removesuffix(ending)


def is_order(name: str) -> bool:
    return name.endswith(_ORDER) and not name.startswith(".") and name.isprintable()


def _answers_of(told: bytes) -> tuple[InboxAnswer, ...]:
    """The answers in what was told before. The other end could have overwritten it."""
    try:
        return msgspec.json.decode(told, type=InboxTold).answers
    except MALFORMED:
        return ()

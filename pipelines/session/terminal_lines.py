"""Lines of JSON that terminals send to a process of a session, and the answers. A core.

A line to the recorder: `{"record": "start", "options": {"file": "/home/me/run.mcap"}}`. To the file
transfer of an end: `{"file": "put", "first": "a.bin"}`; likewise get, list, rename and remove. Its
answer has the number of the transfer, with which `state` asks how far it is.
"""

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Generic, NamedTuple, TypeVar

import msgspec

from kontur_av.clock import NS_PER_S
from pipelines.session.setup.segments import Segment
from telepresence.malformed import MALFORMED

#: A longer line is cut, and so no request.
MAX_LINE_OCTETS = 8192
#: The most terminals that may ask at once; others are refused.
MOST_TERMINALS = 8

_Content = TypeVar("_Content", bound=msgspec.Struct)


def pack_line(content: msgspec.Struct) -> bytes:
    return msgspec.json.encode(content) + b"\n"


def parse_line(line: bytes, kind: type[_Content]) -> _Content | None:
    """Return the request or the answer in a line, or None for anything else."""
    try:
        return msgspec.json.decode(line, type=kind)
    except MALFORMED:
        return None


class Reply(NamedTuple):
    """Octets for a terminal. last: close the connection after them."""

    terminal: int
    octets: bytes
    last: bool


_Event = TypeVar("_Event")


class TerminalServer(Generic[_Event]):
    """Terminals that ask. Read from those in `asking` only, and drain `next_event` afterwards.

    A terminal is a connection, known by a number that is never used again.
    """

    def __init__(self) -> None:
        #: By terminal: what it has sent so far.
        self._lines: dict[int, bytes] = {}
        self._events: deque[Reply | _Event] = deque()

    @property
    def asking(self) -> list[int]:
        """The terminals whose lines are not complete yet."""
        return list(self._lines)

    def handle_terminal(self, terminal: int) -> None:
        if len(self._lines) >= MOST_TERMINALS:
            self._events.append(Reply(terminal, b"", last=True))
        else:
            self._lines[terminal] = b""

    def handle_octets(self, terminal: int, data: bytes, now_ns: int) -> None:
        """A terminal in `asking` has sent octets, b"" if it has closed its side."""
        raise NotImplementedError

    def next_event(self) -> Reply | _Event | None:
        return self._events.popleft() if self._events else None


class LineServer(TerminalServer[Reply], Generic[_Content]):
    """Answers one line of each terminal.

    kind: of the requests. answer: called with a request and its instant; anything else is not
    answered.
    """

    def __init__(
        self, kind: type[_Content], answer: Callable[[_Content, int], msgspec.Struct]
    ) -> None:
        super().__init__()
        self._kind, self._answer = kind, answer

    def handle_octets(self, terminal: int, data: bytes, now_ns: int) -> None:
        line = self._lines[terminal] = self._lines[terminal] + data
        if b"\n" not in line and data and len(line) < MAX_LINE_OCTETS:
            return
        del self._lines[terminal]
        request = parse_line(line, self._kind)
        octets = b"" if request is None else pack_line(self._answer(request, now_ns))
        self._events.append(Reply(terminal, octets, last=True))


START, STOP, STATE = "start", "stop", "state"


@dataclass(frozen=True, kw_only=True)
class PartLimits:
    """When a new part begins: after `ns`, or with `octets`."""

    ns: int = 600 * NS_PER_S
    octets: int = 256_000_000


class RecordingOptions(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """What is to be recorded, and into which file.

    file: absolute path of the first part. link_frames: with every frame of the radio link.
    part_s, part_mb: when a new part begins. command: the command line that wished it.
    held: end the recording when its terminal has gone.
    """

    file: str
    link_frames: bool = False
    part_s: float = 600.0
    part_mb: float = 256.0
    command: str = ""
    held: bool = False

    @property
    def limits(self) -> PartLimits:
        return PartLimits(ns=round(self.part_s * NS_PER_S), octets=round(self.part_mb * 1e6))


class RecordRequest(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A request. overwrite: replace a recording that is there."""

    record: str
    options: RecordingOptions | None = None
    overwrite: bool = False


class RecordAnswer(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """An answer. files: how many parts there are. lost: messages that are in none of them."""

    ok: bool
    error: str = ""
    mistake: bool = False
    file: str = ""
    files: int = 0
    messages: int = 0
    lost: int = 0
    fault: str = ""


CANCEL, STATUS = "cancel", "status"


def socket_name(segment: Segment) -> str:
    return f"files.{segment.value}"


class FileRequest(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A request. first, second: names in the directories. number: of a transfer."""

    file: str
    first: str = ""
    second: str = ""
    number: int = -1


class TransferNow(msgspec.Struct, frozen=True, kw_only=True):
    """A transfer under way. octets, size: as of `FileAnswer`. first: the name of its file."""

    number: int
    kind: str
    state: str
    octets: int
    size: int
    first: str


class FileAnswer(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """An answer. mistake: the request itself was wrong, and text says why.

    octets: transferred so far. size: of the file; -1 if it is not known. transfers: those under way
    that were asked for at this end, the oldest first. more: how many of them are left out.
    """

    ok: bool
    text: str = ""
    mistake: bool = False
    number: int = -1
    state: str = ""
    octets: int = 0
    size: int = -1
    transfers: tuple[TransferNow, ...] = ()
    more: int = 0


def progress(answer: FileAnswer) -> str:
    return f"{_octets(answer)} octets"


def _octets(one: FileAnswer | TransferNow) -> str:
    return f"{one.octets}{f' of {one.size}' if one.size >= 0 else ''}"


def listing(answer: FileAnswer) -> str:
    """A line for each transfer under way."""
    if not answer.transfers:
        return "nothing is under way"
    lines = [f"{'number':<11} {'what':<7} {'state':<9} {'octets':>16}  name"]
    for one in answer.transfers:
        octets = _octets(one)
        lines.append(f"{one.number:<11} {one.kind:<7} {one.state:<9} {octets:>16}  {one.first}")
    return "\n".join([*lines, *([f"and {answer.more} more"] if answer.more else [])])

"""What terminals ask of the file transfer, and the answers, as lines of JSON. A core.

Request: `{"file": "put", "first": "a.bin"}`; likewise get, list, rename and remove. The answer has
the number of the transfer, with which `state` asks how far it is, and `cancel` gives it up.
`status` lists all that are under way.
"""

import msgspec

from kontur_av.errors import ConfigError
from pipelines.session.setup.segments import Segment
from telepresence.files.entity import DONE, FAILED, PUT, FileEntity, Transfer
from telepresence.files.pdus import GET, LIST, REMOVE, RENAME

STATE, CANCEL, STATUS = "state", "cancel", "status"
SILENT = "the other end does not answer: is --files given there?"
KINDS = (PUT, GET, LIST, RENAME, REMOVE)
#: The entities' ids.
ENTITIES = {Segment.GROUND: 1, Segment.SPACE: 2}
#: What a segment may send at most, by default.
RATES_BPS = {Segment.GROUND: 8_000, Segment.SPACE: 200_000}


def desk_name(segment: Segment) -> str:
    """The name of the Unix socket."""
    return f"files.{segment.value}"


class FileRequest(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A request. first, second: names in the directories. number: of a transfer."""

    file: str
    first: str = ""
    second: str = ""
    number: int = -1


class FileAnswer(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """An answer. mistake: the request itself was wrong, and text says why.

    octets, size: as far as they came or went; size is -1 if it is not known.
    """

    ok: bool
    text: str = ""
    mistake: bool = False
    number: int = -1
    state: str = ""
    octets: int = 0
    size: int = -1


class FileDesk:
    """Hands requests to the entity, and answers how its transfers are."""

    def __init__(self, entity: FileEntity) -> None:
        self._entity = entity

    def handle_request(
        self, request: FileRequest, octets: bytes, refusal: str, now_ns: int
    ) -> FileAnswer:
        """octets: of the file that is to be put; refusal: why they could not be read."""
        entity = self._entity
        if request.file == STATE:
            transfer = entity.transfers.get(request.number)
            if transfer is None:
                return FileAnswer(ok=False, text="the session does not know this transfer any more")
            return self._answer(transfer, now_ns)
        if request.file == STATUS:
            return FileAnswer(ok=True, text=self._listing(), state=DONE)
        if request.file not in (*KINDS, CANCEL):
            known = ", ".join((*KINDS, STATE, CANCEL, STATUS))
            text = f"no request {request.file}: take one of {known}"
            return FileAnswer(ok=False, text=text, mistake=True)
        try:
            if refusal:
                raise ConfigError(refusal)
            if request.file == CANCEL:
                entity.cancel(request.number, now_ns)
                return FileAnswer(ok=True, text="cancelled", state=DONE)
            if request.file == PUT:
                transfer = entity.put(request.first, request.second, octets, now_ns)
            else:
                transfer = entity.ask(request.file, request.first, request.second, now_ns)
            return self._answer(transfer, now_ns)
        except ConfigError as error:
            return FileAnswer(ok=False, text=str(error), mistake=True)

    def _listing(self) -> str:
        """A line for each transfer that was asked for here and is under way."""
        lines = [f"{'number':<11} {'what':<7} {'state':<9} {'octets':>16}  name"]
        for one in self._entity.transfers.values():
            if one.state not in (DONE, FAILED):
                octets = f"{one.octets}{f' of {one.size}' if one.size >= 0 else ''}"
                state = self._entity.state_of(one)
                lines.append(f"{one.number:<11} {one.kind:<7} {state:<9} {octets:>16}  {one.first}")
        return "\n".join(lines) if lines[1:] else "nothing is under way"

    def _answer(self, transfer: Transfer, now_ns: int) -> FileAnswer:
        silent = SILENT if self._entity.unanswered(transfer, now_ns) else ""
        return FileAnswer(
            ok=True,
            text=transfer.reason or transfer.text or silent,
            number=transfer.number,
            state=self._entity.state_of(transfer),
            octets=transfer.octets,
            size=transfer.size,
        )

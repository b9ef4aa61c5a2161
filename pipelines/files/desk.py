"""What terminals ask of the file transfer, and the answers, as lines of JSON. A core.

Request: `{"file": "put", "first": "a.bin"}`; likewise get, list, rename and remove. The answer has
the number of the transfer, with which `state` asks how far it is.
"""

import msgspec

from kontur_av.errors import ConfigError
from pipelines.session.setup.segments import Segment
from telepresence.files.entity import PUT, FileEntity, Transfer
from telepresence.files.pdus import GET, LIST, REMOVE, RENAME

STATE = "state"
KINDS = (PUT, GET, LIST, RENAME, REMOVE)
#: The entities' ids.
ENTITIES = {Segment.GROUND: 1, Segment.SPACE: 2}
#: What a segment may send at most, by default.
RATES_BPS = {Segment.GROUND: 8_000, Segment.SPACE: 200_000}


def desk_name(segment: Segment) -> str:
    """The name of the Unix socket."""
    return f"files.{segment.value}"


class FileRequest(msgspec.Struct, frozen=True, kw_only=True, omit_defaults=True):
    """A request. first, second: names in the directories. number: of the transfer, for `state`."""

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
            return self._answer(transfer)
        if request.file not in KINDS:
            text = f"no request {request.file}: take {', '.join(KINDS)} or {STATE}"
            return FileAnswer(ok=False, text=text, mistake=True)
        try:
            if refusal:
                raise ConfigError(refusal)
            if request.file == PUT:
                return self._answer(entity.put(request.first, request.second, octets, now_ns))
            return self._answer(entity.ask(request.file, request.first, request.second, now_ns))
        except ConfigError as error:
            return FileAnswer(ok=False, text=str(error), mistake=True)

    def _answer(self, transfer: Transfer) -> FileAnswer:
        return FileAnswer(
            ok=True,
            text=transfer.reason or transfer.text,
            number=transfer.number,
            state=self._entity.state_of(transfer),
            octets=transfer.octets,
            size=transfer.size,
        )

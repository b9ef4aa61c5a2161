"""Answers what the file transfer of an end is asked. A core."""

from kontur_av.errors import ConfigError
from pipelines.session.setup.segments import Segment
from pipelines.session.transfer_requests import (
    CANCEL,
    STATE,
    STATUS,
    FileAnswer,
    FileRequest,
    TransferNow,
)
from telepresence.files.entity import DONE, FAILED, PUT, FileEntity, Transfer
from telepresence.files.pdus import GET, LIST, REMOVE, RENAME

SILENT = "the other end does not answer: is --files given there?"
KINDS = (PUT, GET, LIST, RENAME, REMOVE)
#: The entities' ids.
ENTITIES = {Segment.GROUND: 1, Segment.SPACE: 2}
#: This many fit into one answer, however long their names are.
_MOST_LISTED = 12


class FileRequests:
    """Hands requests to the entity, and answers how its transfers are."""

    def __init__(self, entity: FileEntity) -> None:
        self._entity = entity

    def handle_request(
        self, request: FileRequest, octets: bytes, refusal: str, now_ns: int
    ) -> FileAnswer:
        """octets: of the file that is to be put; refusal: why they could not be read.

        ConfigError for a request that is wrong.
        """
        entity = self._entity
        if request.file == STATE:
            transfer = entity.transfers.get(request.number)
            if transfer is None:
                text = "the session does not know this transfer any more"
                return FileAnswer(state=FAILED, text=text)
            return self._answer(transfer, now_ns)
        if request.file == STATUS:
            return self._listing()
        if request.file not in (*KINDS, CANCEL):
            known = ", ".join((*KINDS, STATE, CANCEL, STATUS))
            raise ConfigError(f"no request {request.file}: take one of {known}")
        if refusal:
            raise ConfigError(refusal)
        if request.file == CANCEL:
            entity.cancel(request.number, now_ns)
            return FileAnswer(text="cancelled", state=DONE)
        if request.file == PUT:
            transfer = entity.put(request.first, request.second, octets, now_ns)
        else:
            transfer = entity.ask(request.file, request.first, request.second, now_ns)
        return self._answer(transfer, now_ns)

    def _listing(self) -> FileAnswer:
        """The transfers that were asked for here and are under way."""
        open_yet = [
            one for one in self._entity.transfers.values() if one.state not in (DONE, FAILED)
        ]
        listed = tuple(
            TransferNow(
                number=one.number,
                kind=one.kind,
                state=self._entity.state_of(one),
                octets=one.octets,
                size=one.size,
                first=one.first,
            )
            for one in open_yet[:_MOST_LISTED]
        )
        more = len(open_yet) - len(listed)
        return FileAnswer(state=DONE, transfers=listed, more=more)

    def _answer(self, transfer: Transfer, now_ns: int) -> FileAnswer:
        silent = SILENT if self._entity.unanswered(transfer, now_ns) else ""
        return FileAnswer(
            text=transfer.reason or transfer.text or silent,
            number=transfer.number,
            state=self._entity.state_of(transfer),
            octets=transfer.octets,
            size=transfer.size,
        )

"""The receiving side of one transaction: CCSDS 727.0-B-5 clauses 4.6.1, 4.6.4 and 4.7."""

from hashlib import sha256

from kontur_av.clock import NS_PER_S
from telepresence.files.pdus import (
    Ack,
    ConditionCode,
    DirectiveType,
    Eof,
    FileData,
    FileStatus,
    Finished,
    KeepAlive,
    Key,
    Metadata,
    Nak,
    Pdu,
    Segments,
)
from telepresence.files.sender import KNOWN_SUMS, TransactionPace, file_sum

#: The largest file. Until it is whole it is in memory, at both ends.
MAX_FILE_OCTETS = 16 << 20
#: How often a sender that still sends learns that somebody receives (clause 4.6.5).
_ALIVE_NS = 5 * NS_PER_S
#: The most ranges that one NAK asks for; the next one asks for others.
_MOST_RANGES = 48
_WHY = {
    ConditionCode.FILE_CHECKSUM_FAILURE: "the checksum is wrong",
    ConditionCode.FILE_SIZE_ERROR: "the file is larger than allowed or announced",
    ConditionCode.FILESTORE_REJECTION: "the directory there refuses it",
    ConditionCode.UNSUPPORTED_CHECKSUM_TYPE: "the checksum is of an unknown kind",
    ConditionCode.CANCEL_REQUEST_RECEIVED: "cancelled",
    ConditionCode.INACTIVITY_DETECTED: "the other end fell silent",
}


def why(condition: int) -> str:
    """A condition in words."""
    code = ConditionCode(condition)
    name: str = code.name
    return _WHY.get(code, name.lower().replace("_", " "))


class FileReceiver:
    """Puts one file together. All instants are of the time in contact.

    Once `whole`, store `octets` or do what the metadata ask for, then call `handle_stored`.

    finished: what the sender is told at the end; None before. ended: it knows, or fell silent.
    repeated_octets: of the file that came more than once.
    """

    def __init__(self, key: Key, pace: TransactionPace, now_ns: int) -> None:
        self.key = key
        self.metadata: Metadata | None = None
        self.finished: Finished | None = None
        self.whole = self.ended = False
        self.repeated_octets = 0
        self._pace = pace
        self._data = bytearray()
        self._there = Segments()
        self._eof: Eof | None = None
        self._ack: Ack | None = None
        self._heard_ns = self._due_ns = self._alive_ns = now_ns
        self._alive_due = False

    @property
    def octets(self) -> bytes:
        return bytes(self._data)

    @property
    def received_octets(self) -> int:
        return self._there.octets

    @property
    def size(self) -> int | None:
        """As far as it is known."""
        if self.metadata is not None:
            return self.metadata.size
        return None if self._eof is None else self._eof.size

    def handle_pdu(self, pdu: Pdu, now_ns: int) -> None:
        """A PDU of the sender."""
        self._heard_ns = now_ns
        if now_ns >= self._alive_ns:
            self._alive_due, self._alive_ns = True, now_ns + _ALIVE_NS
        if isinstance(pdu, Eof):
            self._ack = Ack(
                key=self.key,
                of=DirectiveType.EOF_PDU,
                condition=ConditionCode(pdu.condition),
                active=self.finished is None,
            )
        if isinstance(pdu, Ack):
            self.ended = self.finished is not None
        elif self.finished is None and not self.whole:
            self._take(pdu, now_ns)

    def cancel(self, now_ns: int) -> None:
        """The user does not want the file any more (clause 4.11.2.3)."""
        if self.finished is None:
            self._fail(ConditionCode.CANCEL_REQUEST_RECEIVED, now_ns)

    def handle_stored(self, refusal: str, now_ns: int) -> None:
        """What was asked for is done; else refusal says why not."""
        assert self.metadata is not None
        request = self.metadata.request
        condition = ConditionCode.FILESTORE_REJECTION if refusal else ConditionCode.NO_ERROR
        status = FileStatus.FILE_RETAINED
        if not self.metadata.destination:
            status = FileStatus.FILE_STATUS_UNREPORTED
        elif refusal:
            status = FileStatus.DISCARDED_FILESTORE_REJECTION
        self._finish(
            Finished(
                key=self.key,
                condition=condition,
                complete=not refusal,
                status=status,
                request=request,
                reason=refusal,
            ),
            now_ns,
        )

    def poll_transmit(self, now_ns: int) -> Pdu | None:
        """Return the next PDU, or None."""
        if self._ack is not None:
            ack, self._ack = self._ack, None
            return ack
        if self.ended:
            return None
        if now_ns - self._heard_ns >= self._pace.patience_ns:
            if self.finished is not None:
                self.ended = True
                return None
            if not self.whole:
                self._fail(ConditionCode.INACTIVITY_DETECTED, now_ns)
                self._heard_ns = now_ns
        if self._alive_due and self._eof is None and self.finished is None:
            self._alive_due = False
            return KeepAlive(key=self.key, octets=self.received_octets)
        if now_ns < self._due_ns:
            return None
        if self.finished is not None:
            self._due_ns = now_ns + self._pace.repeat_ns
            return self.finished
        if self._eof is None or self.whole:
            return None
        self._due_ns = now_ns + self._pace.repeat_ns
        ranges = self._there.missing(self._eof.size, _MOST_RANGES)
        return Nak(key=self.key, ranges=ranges, metadata=self.metadata is None)

    def poll_timeout(self) -> int | None:
        """When `poll_transmit` has something next, or None."""
        if self._ack is not None:
            return 0
        if self.ended or (self.whole and self.finished is None):
            return None
        patience_ns = self._heard_ns + self._pace.patience_ns
        waits = self.finished is None and self._eof is None
        if waits and self._alive_due:
            return 0
        return patience_ns if waits else min(self._due_ns, patience_ns)

    def _take(self, pdu: Pdu, now_ns: int) -> None:
        if isinstance(pdu, FileData):
            end = pdu.offset + len(pdu.data)
            size = self.size
            if end > (MAX_FILE_OCTETS if size is None else size):
                self._fail(ConditionCode.FILE_SIZE_ERROR, now_ns)
                return
            self._data.extend(bytes(max(0, end - len(self._data))))
            self._data[pdu.offset : end] = pdu.data
            self.repeated_octets += len(pdu.data) - self._there.add(pdu.offset, end)
            # As long as data come, what is missing may be among them (clause 4.6.4.7).
            self._due_ns = now_ns + self._pace.repeat_ns
        elif isinstance(pdu, Metadata):
            self.metadata = self.metadata or pdu
        elif isinstance(pdu, Eof):
            if pdu.condition != ConditionCode.NO_ERROR:
                self._fail(ConditionCode.CANCEL_REQUEST_RECEIVED, now_ns)
                return
            if self._eof is None:
                self._eof, self._due_ns = pdu, now_ns
        self._check(now_ns)

    def _check(self, now_ns: int) -> None:
        metadata, eof = self.metadata, self._eof
        if metadata is not None and metadata.size > MAX_FILE_OCTETS:
            self._fail(ConditionCode.FILE_SIZE_ERROR, now_ns)
        elif metadata is not None and metadata.checksum not in KNOWN_SUMS:
            self._fail(ConditionCode.UNSUPPORTED_CHECKSUM_TYPE, now_ns)
        elif self.size is not None and self._there.end > self.size:
            self._fail(ConditionCode.FILE_SIZE_ERROR, now_ns)
        elif eof is None:
            return
        elif eof.size > MAX_FILE_OCTETS or (metadata is not None and metadata.size != eof.size):
            self._fail(ConditionCode.FILE_SIZE_ERROR, now_ns)
        elif metadata is not None and not self._there.missing(eof.size, 1):
            right = file_sum(metadata.checksum, self._data) == eof.checksum
            if right and metadata.sha256 in (b"", sha256(self._data).digest()):
                self.whole = True
            else:
                self._fail(ConditionCode.FILE_CHECKSUM_FAILURE, now_ns)

    def _fail(self, condition: ConditionCode, now_ns: int) -> None:
        status = FileStatus.DISCARDED_DELIBERATELY
        self._finish(
            Finished(key=self.key, condition=condition, complete=False, status=status), now_ns
        )

    def _finish(self, finished: Finished, now_ns: int) -> None:
        self.finished = finished
        self._due_ns = now_ns
        self._data = bytearray()

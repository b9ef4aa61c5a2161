"""The two sides of one transaction, and checksums: CCSDS 727.0-B-5 clauses 4.6.1, 4.6.4 and 4.7.

Checksums: clause 4.2.2 and annex F, and SHA-256.
"""

from binascii import crc32
from dataclasses import dataclass
from hashlib import sha256

import numpy as np

from kontur_av.clock import NS_PER_S
from telepresence.files.pdus import (
    Ack,
    ChecksumType,
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
)
from telepresence.link.octet_streams import OutgoingOctets, RangeSet

#: Those that this end can check.
KNOWN_SUMS = (ChecksumType.CRC_32, ChecksumType.MODULAR, ChecksumType.NULL_CHECKSUM)


def file_sum(kind: int, octets: bytes | bytearray) -> bytes:
    """Return the four octets of a checksum of `KNOWN_SUMS`; KeyError for another."""
    if kind == ChecksumType.NULL_CHECKSUM:
        return bytes(4)
    if kind == ChecksumType.CRC_32:
        return crc32(octets).to_bytes(4, "big")
    if kind == ChecksumType.MODULAR:
        padded = bytes(octets) + bytes(-len(octets) % 4)
        words = np.frombuffer(padded, ">u4")
        return (int(words.sum(dtype=np.uint64)) & 0xFFFFFFFF).to_bytes(4, "big")
    raise KeyError(kind)


CANCELLED = "cancelled"
#: An EOF that was acknowledged is repeated more seldom: the receiver may have been started again.
_SELDOM = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class TransactionPace:
    """segment_octets: of a file in one PDU. repeat_ns: until an unanswered PDU is sent again.

    timeout_ns: how long the other end may be silent before the transaction fails.
    """

    segment_octets: int
    repeat_ns: int
    timeout_ns: int


class FileSender:
    """Sends one file, or metadata alone. All instants are of the time in contact.

    done: what the receiver said at the end; failure: why nobody said it, "" if not yet.
    began_ns: when the metadata were sent first; None if not yet.
    sent_octets: of the file for the first time; resent_octets: again.
    """

    def __init__(
        self, metadata: Metadata, octets: bytes, pace: TransactionPace, now_ns: int
    ) -> None:
        self.metadata = metadata
        self.done: Finished | None = None
        self.failure = ""
        self.began_ns: int | None = None
        self.resent_octets = 0
        self._out, self._pace = OutgoingOctets(octets), pace
        self._metadata_due = True
        self._eof = Eof(
            key=metadata.key, size=len(octets), checksum=file_sum(metadata.checksum, octets)
        )
        self._eof_ns = self._heard_ns = now_ns
        self._eof_sent = self._eof_acknowledged = False
        self._closing: Ack | None = None

    @property
    def size(self) -> int:
        return self._out.end

    @property
    def sent_octets(self) -> int:
        return self._out.sent

    @property
    def ended(self) -> bool:
        """Whether the transaction is over, and its last PDU was sent."""
        return bool(self.failure) or (self.done is not None and self._closing is None)

    def handle_pdu(self, pdu: Pdu, now_ns: int) -> None:
        """A PDU of the receiver."""
        self._heard_ns = now_ns
        if isinstance(pdu, Nak):
            self._metadata_due = self._metadata_due or pdu.metadata
            for start, end in pdu.ranges:
                # What comes anyway needs no retransmission.
                self._out.handle_lost(start, end)
        elif isinstance(pdu, Ack) and pdu.of == DirectiveType.EOF_PDU:
            if pdu.condition != self._eof.condition:
                return
            if self._eof.condition != ConditionCode.NO_ERROR:
                self.failure = CANCELLED
            self._eof_acknowledged = True
            self._eof_ns = now_ns + _SELDOM * self._pace.repeat_ns
        elif isinstance(pdu, Finished):
            self.done = pdu
            self._closing = closing(pdu)

    def cancel(self) -> None:
        """The rest shall not go, and the receiver is told (clause 4.11.2.2)."""
        if self.began_ns is None:
            self.failure = CANCELLED
        if self.ended or self.done is not None:
            return
        octets = self._out.cut()
        self._metadata_due = self._eof_sent = self._eof_acknowledged = False
        self._eof = Eof(
            key=self.metadata.key,
            size=self.size,
            checksum=file_sum(self.metadata.checksum, octets),
            condition=ConditionCode.CANCEL_REQUEST_RECEIVED,
        )

    def poll_transmit(self, now_ns: int) -> Pdu | None:
        """Return the next PDU, or None."""
        if self._closing is not None:
            ack, self._closing = self._closing, None
            return ack
        if self.ended:
            return None
        key = self.metadata.key
        if self._metadata_due:
            self._metadata_due = False
            if self.began_ns is None:
                self.began_ns = now_ns
            return self.metadata
        again = self._out.lost
        piece = self._out.next_piece(self._pace.segment_octets)
        if piece is not None:
            offset, data = piece
            self.resent_octets += len(data) if again else 0
            return FileData(key=key, offset=offset, data=data)
        if not self._eof_sent:
            self._eof_sent = True
            self._heard_ns = now_ns
        elif now_ns - self._heard_ns >= self._pace.timeout_ns:
            self.failure = "the other end is silent: does it run with --files?"
            return None
        elif now_ns < self._eof_ns:
            return None
        seldom = _SELDOM if self._eof_acknowledged else 1
        self._eof_ns = now_ns + seldom * self._pace.repeat_ns
        return self._eof

    def poll_timeout(self) -> int | None:
        """When `poll_transmit` has something next; None if the transaction is over."""
        if self.ended:
            return None
        if self._closing or self._metadata_due or self._out.lost or not self._eof_sent:
            return 0
        return min(self._eof_ns, self._heard_ns + self._pace.timeout_ns)


def closing(finished: Finished) -> Ack:
    """The answer to a Finished PDU, also of a transaction that is over (clause 4.7.2)."""
    return Ack(
        key=finished.key,
        of=DirectiveType.FINISHED_PDU,
        condition=ConditionCode(finished.condition),
        active=False,
    )


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
        self._there = RangeSet()
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
        if now_ns - self._heard_ns >= self._pace.timeout_ns:
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
        timeout_ns = self._heard_ns + self._pace.timeout_ns
        waits = self.finished is None and self._eof is None
        if waits and self._alive_due:
            return 0
        return timeout_ns if waits else min(self._due_ns, timeout_ns)

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

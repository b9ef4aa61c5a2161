"""The sending side of one transaction: CCSDS 727.0-B-5 clauses 4.6.1, 4.6.4 and 4.7.1; checksums.

Checksums: clause 4.2.2 and annex F, and SHA-256.
"""

from binascii import crc32
from dataclasses import dataclass

import numpy as np

from telepresence.files.pdus import (
    Ack,
    ChecksumType,
    ConditionCode,
    DirectiveType,
    Eof,
    FileData,
    Finished,
    Metadata,
    Nak,
    Pdu,
    Segments,
)

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
    """segment_octets: of a file in one PDU. repeat_ns: until what nobody answered is sent again.

    patience_ns: how long the other end may be silent before the transaction fails.
    """

    segment_octets: int
    repeat_ns: int
    patience_ns: int


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
        self.sent_octets = self.resent_octets = 0
        self._octets, self._pace = octets, pace
        self._metadata_due = True
        self._again = Segments()
        self._eof = Eof(
            key=metadata.key, size=len(octets), checksum=file_sum(metadata.checksum, octets)
        )
        self._eof_ns = self._heard_ns = now_ns
        self._eof_sent = self._eof_acknowledged = False
        self._closing: Ack | None = None

    @property
    def size(self) -> int:
        return len(self._octets)

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
                self._again.add(start, min(end, self.sent_octets))
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
        self._octets, self._again = self._octets[: self.sent_octets], Segments()
        self._metadata_due = self._eof_sent = self._eof_acknowledged = False
        self._eof = Eof(
            key=self.metadata.key,
            size=self.size,
            checksum=file_sum(self.metadata.checksum, self._octets),
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
        if self._again:
            start, end = self._again.take(self._pace.segment_octets)
            self.resent_octets += end - start
            return FileData(key=key, offset=start, data=self._octets[start:end])
        start = self.sent_octets
        if start < self.size:
            self.sent_octets = end = min(start + self._pace.segment_octets, self.size)
            return FileData(key=key, offset=start, data=self._octets[start:end])
        if not self._eof_sent:
            self._eof_sent = True
            self._heard_ns = now_ns
        elif now_ns - self._heard_ns >= self._pace.patience_ns:
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
        if self._closing or self._metadata_due or self._again or not self._eof_sent:
            return 0
        return min(self._eof_ns, self._heard_ns + self._pace.patience_ns)


def closing(finished: Finished) -> Ack:
    """The answer to a Finished PDU, also of a transaction that is over (clause 4.7.2)."""
    return Ack(
        key=finished.key,
        of=DirectiveType.FINISHED_PDU,
        condition=ConditionCode(finished.condition),
        active=False,
    )

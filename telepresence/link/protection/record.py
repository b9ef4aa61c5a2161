"""The record: one transfer frame, encrypted and authenticated, in one datagram.

docs/security.md has its fields. AES-256-GCM (NIST SP 800-38D) encrypts. The header is its
additional data. Its nonce is the direction's initialisation vector, combined with the sequence
number as in RFC 8446 section 5.3.
"""

from dataclasses import dataclass

from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.ciphers.aead import AESGCM

#: The first octet of a datagram: version 1 in its upper half, the kind in its lower half.
RECORD = 0x11
HANDSHAKE = 0x12

KEY_NUMBER_OCTETS = 3
SEQUENCE_OCTETS = 6
HEADER_OCTETS = 1 + KEY_NUMBER_OCTETS + SEQUENCE_OCTETS
TAG_OCTETS = 16
#: What a record adds to the length of its frame, always.
OVERHEAD_OCTETS = HEADER_OCTETS + TAG_OCTETS

KEY_OCTETS = 32
NONCE_OCTETS = 12
#: One direction: key and initialisation vector.
DIRECTION_OCTETS = KEY_OCTETS + NONCE_OCTETS

#: This many sequence numbers behind the newest are still accepted, each once: one second of slots.
WINDOW = 1024
#: Most records under one key. SP 800-38D section 8.3 allows 2^32 calls with one key.
MOST_RECORDS = 1 << 32


@dataclass(frozen=True, slots=True)
class DirectionKeys:
    """Keys of one direction. number: 3 octets; key: 32; vector: 12. Never shown by `repr`."""

    number: bytes
    key: bytes
    vector: bytes

    def __post_init__(self) -> None:
        lengths = (len(self.number), len(self.key), len(self.vector))
        if lengths != (KEY_NUMBER_OCTETS, KEY_OCTETS, NONCE_OCTETS):
            raise ValueError(f"keys of {lengths} octets")

    def __repr__(self) -> str:
        return f"DirectionKeys(number={self.number.hex()})"


class RecordSealer:
    """Seals the frames of one direction under one key. sealed: how many, so far."""

    def __init__(self, keys: DirectionKeys) -> None:
        self._encrypt = AESGCM(keys.key).encrypt
        self._vector = int.from_bytes(keys.vector, "big")
        self._head = bytes([RECORD]) + keys.number
        self.sealed = 0

    def seal(self, frame: bytes) -> bytes:
        """Return the record of `frame`; it is `OVERHEAD_OCTETS` longer.

        Raises OverflowError after `MOST_RECORDS`: the key must have been replaced long before.
        """
        sequence = self.sealed
        if sequence >= MOST_RECORDS:
            raise OverflowError("too many records under one key")
        self.sealed = sequence + 1
        head = self._head + sequence.to_bytes(SEQUENCE_OCTETS, "big")
        nonce = (self._vector ^ sequence).to_bytes(NONCE_OCTETS, "big")
        return head + self._encrypt(nonce, frame, head)


class RecordOpener:
    """Opens the records of one direction under one key, each once.

    newest: the largest sequence number of a genuine record; -1 before the first.
    """

    def __init__(self, keys: DirectionKeys) -> None:
        self._decrypt = AESGCM(keys.key).decrypt
        self._vector = int.from_bytes(keys.vector, "big")
        #: Bit n: the record with the sequence number `newest - n` has come.
        self._seen = 0
        self.newest = -1

    def open(self, record: bytes) -> bytes | str:
        """Return the frame, or in one word why there is none.

        record: with the header of these keys, and at least `OVERHEAD_OCTETS`. The answers are
        "unauthenticated", "replayed" and "late" (`WINDOW` or more behind the newest). The window is
        looked at and moved only for genuine records, so no forgery moves it.
        """
        head = record[:HEADER_OCTETS]
        sequence = int.from_bytes(head[1 + KEY_NUMBER_OCTETS :], "big")
        nonce = (self._vector ^ sequence).to_bytes(NONCE_OCTETS, "big")
        try:
            frame = self._decrypt(nonce, record[HEADER_OCTETS:], head)
        except InvalidTag:
            return "unauthenticated"
        behind = self.newest - sequence
        if behind < 0:
            # A jump beyond the window leaves none of the old numbers in it.
            kept = self._seen << -behind if -behind < WINDOW else 0
            self._seen = (kept | 1) & ((1 << WINDOW) - 1)
            self.newest = sequence
            return frame
        if behind >= WINDOW:
            return "late"
        if self._seen >> behind & 1:
            return "replayed"
        self._seen |= 1 << behind
        return frame


def key_number(record: bytes) -> bytes:
    """Return the key number of a record, 3 octets."""
    return record[1 : 1 + KEY_NUMBER_OCTETS]

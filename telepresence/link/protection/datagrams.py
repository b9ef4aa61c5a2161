"""The datagrams between two protected ends: records with frames, and segments of a handshake.

A record is one transfer frame, encrypted and authenticated, in one datagram. docs/security.md has
its fields. Records of further kinds have several frames, or a report of what arrived, for ends that
both know them.
AES-256-GCM (NIST SP 800-38D) encrypts. The header is its additional data. Its nonce is the
direction's initialisation vector, combined with the sequence number as in RFC 8446 section 5.3.

The segments of a handshake are a small reliable octet stream each way, as QUIC's CRYPTO frames:

| octets | field |
|--:|---|
| 1 | version (4 bits, 1) and kind (4 bits, `HANDSHAKE` or `KNOCK`) |
| 8 | nonce of the sender |
| 8 | nonce of the receiver that the sender has heard last; zeros before |
| 2 | acknowledged: octets of the receiver's stream that have come without a gap |
| 2 | offset of the data in the sender's stream |
| n | data |
| 16 | code: HMAC-SHA-256 (RFC 2104), cut to 128 bits, keyed with both identities |

The code proves only that the sender knows both identities. It keeps port scanners and stray
datagrams away from the handshake; what proves the sender is the handshake itself (RFC 8446).
"""

import hmac
import struct
from dataclasses import dataclass
from hashlib import sha256

from cryptography.exceptions import InvalidTag
from cryptography.hazmat.primitives.ciphers.aead import AESGCM

from telepresence.link.protection.identity import MachineIdentity

#: The first octet of a datagram: version 1 in its upper half, the kind in its lower half.
RECORD = 0x11
HANDSHAKE = 0x12
#: As `HANDSHAKE`, and asks for a session.
KNOCK = 0x13
#: Records of several frames: whole, and without what is idle (telepresence.link.path.bundles).
PACKED, COMPACT = 0x14, 0x15
#: A record with a report of what arrived (telepresence.link.path.following).
REPORT = 0x16
RECORDS = (RECORD, PACKED, COMPACT, REPORT)

KEY_NUMBER_OCTETS = 3
SEQUENCE_OCTETS = 6
HEADER_OCTETS = 1 + KEY_NUMBER_OCTETS + SEQUENCE_OCTETS
TAG_OCTETS = 16
#: What a record adds to the length of its frame, always.
OVERHEAD_OCTETS = HEADER_OCTETS + TAG_OCTETS

KEY_OCTETS = 32
VECTOR_OCTETS = 12
#: One direction: key and initialisation vector.
DIRECTION_OCTETS = KEY_OCTETS + VECTOR_OCTETS

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
        if lengths != (KEY_NUMBER_OCTETS, KEY_OCTETS, VECTOR_OCTETS):
            raise ValueError(f"keys of {lengths} octets")

    def __repr__(self) -> str:
        return f"DirectionKeys(number={self.number.hex()})"


class RecordSealer:
    """Seals the frames of one direction under one key. sealed: how many, so far."""

    def __init__(self, keys: DirectionKeys) -> None:
        self._encrypt = AESGCM(keys.key).encrypt
        self._vector = int.from_bytes(keys.vector, "big")
        self._number = keys.number
        self.sealed = 0

    def seal(self, frame: bytes, kind: int = RECORD) -> bytes:
        """Return the record of `frame`; it is `OVERHEAD_OCTETS` longer.

        kind: of what is in the place of a frame, if it is something else.
        Raises OverflowError after `MOST_RECORDS`: the key must have been replaced long before.
        """
        sequence = self.sealed
        if sequence >= MOST_RECORDS:
            raise OverflowError("too many records under one key")
        self.sealed = sequence + 1
        head = bytes((kind,)) + self._number + sequence.to_bytes(SEQUENCE_OCTETS, "big")
        nonce = (self._vector ^ sequence).to_bytes(VECTOR_OCTETS, "big")
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
        sequence = sequence_number(record)
        nonce = (self._vector ^ sequence).to_bytes(VECTOR_OCTETS, "big")
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


def sequence_number(record: bytes) -> int:
    """Return the sequence number of a record."""
    return int.from_bytes(record[1 + KEY_NUMBER_OCTETS : HEADER_OCTETS], "big")


NONCE_OCTETS = 8
NO_NONCE = bytes(NONCE_OCTETS)
CODE_OCTETS = 16
_HEAD = struct.Struct(">B8s8sHH")
#: What a handshake datagram has beside its data.
SEGMENT_OVERHEAD_OCTETS = _HEAD.size + CODE_OCTETS
#: Longest datagram of a handshake: fits into the smallest packet of IPv6 (RFC 8200, 1280 octets).
SEGMENT_OCTETS = 1200
DATA_OCTETS = SEGMENT_OCTETS - SEGMENT_OVERHEAD_OCTETS
#: Longest stream of one side. A handshake takes 2 kB.
STREAM_OCTETS = 16384
#: Segments that wait for one before them.
MOST_EARLY = 16


@dataclass(frozen=True, slots=True)
class HandshakeSegment:
    """One datagram of a handshake. The nonces have 8 octets."""

    knock: bool
    sender: bytes
    receiver: bytes
    acknowledged: int
    offset: int
    data: bytes


class SegmentCodec:
    """Packs the segments of one end and parses those of the other. No state."""

    def __init__(self, own: MachineIdentity, peer: MachineIdentity) -> None:
        self._own_key, self._peer_key = _code_key(own, peer), _code_key(peer, own)

    def pack(self, segment: HandshakeSegment) -> bytes:
        """Return the datagram of a segment."""
        head = _HEAD.pack(
            KNOCK if segment.knock else HANDSHAKE,
            segment.sender,
            segment.receiver,
            segment.acknowledged,
            segment.offset,
        )
        body = head + segment.data
        return body + _code(body, self._own_key)

    def parse(self, datagram: bytes) -> HandshakeSegment | str:
        """Return the peer's segment, or "malformed" or "unauthenticated".

        datagram: of the kind `HANDSHAKE` or `KNOCK`. Before the code, only its length is read.
        """
        if not SEGMENT_OVERHEAD_OCTETS <= len(datagram) <= SEGMENT_OCTETS:
            return "malformed"
        body = datagram[:-CODE_OCTETS]
        if not hmac.compare_digest(_code(body, self._peer_key), datagram[-CODE_OCTETS:]):
            return "unauthenticated"
        kind, sender, receiver, acknowledged, offset = _HEAD.unpack_from(body)
        data = body[_HEAD.size :]
        if sender == NO_NONCE or max(acknowledged, offset + len(data)) > STREAM_OCTETS:
            return "malformed"
        return HandshakeSegment(kind == KNOCK, sender, receiver, acknowledged, offset, data)


def _code_key(sender: MachineIdentity, receiver: MachineIdentity) -> bytes:
    return sha256(b"kontur-av handshake 1" + sender.digest + receiver.digest).digest()


def _code(body: bytes, key: bytes) -> bytes:
    return hmac.digest(key, body, "sha256")[:CODE_OCTETS]

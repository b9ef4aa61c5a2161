"""The datagrams of the protected channel octet by octet, replay windows, and streams in pieces."""

import hmac
from dataclasses import replace
from hashlib import sha256
from random import Random

import pytest
from cryptography.hazmat.primitives.ciphers.aead import AESGCM

from telepresence.link.protection import datagrams
from telepresence.link.protection.datagrams import (
    DATA_OCTETS,
    HANDSHAKE,
    OVERHEAD_OCTETS,
    SEGMENT_OVERHEAD_OCTETS,
    STREAM_OCTETS,
    WINDOW,
    DirectionKeys,
    HandshakeSegment,
    RecordOpener,
    RecordSealer,
    SegmentCodec,
    key_number,
)
from telepresence.link.protection.identity import MachineKey

KEYS = DirectionKeys(b"abc", bytes(range(32)), bytes(range(12)))


def sealed(count):
    sealer = RecordSealer(KEYS)
    return [sealer.seal(b"%d" % number) for number in range(count)]


def test_a_record_is_laid_out_as_the_table_says():
    """AES-256-GCM; the nonce is the vector, combined with the number as in RFC 8446, 5.3."""
    sealer = RecordSealer(KEYS)
    first, second = sealer.seal(b"frame"), sealer.seal(b"frame")
    assert sealer.sealed == 2 and len(first) == 5 + OVERHEAD_OCTETS == 5 + 26
    assert first[:10] == b"\x11abc" + bytes(6) and second[:10] == b"\x11abc" + bytes(5) + b"\x01"
    assert key_number(second) == b"abc"
    nonce = KEYS.vector[:-1] + bytes([KEYS.vector[-1] ^ 1])
    assert AESGCM(KEYS.key).decrypt(nonce, second[10:], second[:10]) == b"frame"
    assert RecordOpener(KEYS).open(second) == b"frame"
    for lengths in ((2, 32, 12), (3, 31, 12), (3, 32, 11)):
        with pytest.raises(ValueError, match="keys of"):
            DirectionKeys(*(bytes(length) for length in lengths))
    shown = repr(KEYS) + str(KEYS)
    assert KEYS.key.hex() not in shown
    assert repr(KEYS.key) not in shown and repr(KEYS.vector) not in shown


def test_a_flipped_bit_anywhere_or_a_cut_is_not_opened():
    (datagram,) = sealed(1)
    opener = RecordOpener(KEYS)
    for bit in range(8 * len(datagram)):
        flipped = bytearray(datagram)
        flipped[bit // 8] ^= 1 << bit % 8
        assert opener.open(bytes(flipped)) == "unauthenticated"
    assert opener.open(datagram[:-1]) == "unauthenticated"
    assert opener.open(datagram) == b"0"


def test_each_record_opens_once_in_any_order_within_the_window():
    records = sealed(WINDOW)
    order = list(range(WINDOW))
    Random(1).shuffle(order)
    opener = RecordOpener(KEYS)
    assert [opener.open(records[number]) for number in order] == [b"%d" % n for n in order]
    assert {opener.open(each) for each in records} == {"replayed"}


def test_what_is_behind_the_window_is_late_and_what_is_in_it_is_not():
    records = sealed(5 * WINDOW)
    opener = RecordOpener(KEYS)
    opener.open(records[0])
    opener.open(records[WINDOW + 1])
    assert opener.open(records[0]) == opener.open(records[1]) == "late"
    assert opener.open(records[2]) == b"2"
    assert opener.open(records[WINDOW + 1]) == opener.open(records[2]) == "replayed"
    # A jump far ahead forgets all older ones.
    assert opener.open(records[-1]) == b"%d" % (5 * WINDOW - 1)
    assert opener.open(records[-2]) == b"%d" % (5 * WINDOW - 2)
    assert opener.open(records[WINDOW + 1]) == "late"


def test_a_forged_number_does_not_move_the_window():
    records = sealed(2)
    opener = RecordOpener(KEYS)
    opener.open(records[0])
    forged = records[0][:4] + (2**40).to_bytes(6, "big") + records[0][10:]
    assert opener.open(forged) == "unauthenticated"
    assert opener.open(records[1]) == b"1"


def test_a_key_is_not_used_for_ever(monkeypatch):
    monkeypatch.setattr(datagrams, "MOST_RECORDS", 2)
    sealer = RecordSealer(KEYS)
    sealer.seal(b"")
    sealer.seal(b"")
    with pytest.raises(OverflowError):
        sealer.seal(b"")


ONE, TWO, THREE = (MachineKey.from_seed(bytes([n] * 32)).identity for n in range(3))
CODEC = SegmentCodec(ONE, TWO)
SEGMENT = HandshakeSegment(True, b"sendernn", b"receiver", 7, 9, b"octets")


def test_a_segment_is_laid_out_as_the_table_says_and_only_the_peer_reads_it():
    datagram = CODEC.pack(SEGMENT)
    head, code = datagram[:-16], datagram[-16:]
    assert len(datagram) == SEGMENT_OVERHEAD_OCTETS + 6
    assert head == b"\x13sendernnreceiver" + bytes((0, 7, 0, 9)) + b"octets"
    key = sha256(b"kontur-av handshake 1" + ONE.digest + TWO.digest).digest()
    assert code == hmac.digest(key, head, "sha256")[:16]
    assert CODEC.pack(replace(SEGMENT, knock=False))[0] == HANDSHAKE
    assert SegmentCodec(TWO, ONE).parse(datagram) == SEGMENT
    for codec in (CODEC, SegmentCodec(THREE, ONE), SegmentCodec(TWO, THREE)):
        assert codec.parse(datagram) == "unauthenticated"
    for bit in range(8 * len(datagram)):
        flipped = bytearray(datagram)
        flipped[bit // 8] ^= 1 << bit % 8
        assert SegmentCodec(TWO, ONE).parse(bytes(flipped)) == "unauthenticated"


@pytest.mark.parametrize(
    "segment",
    [
        HandshakeSegment(False, bytes(8), b"receiver", 0, 0, b""),
        HandshakeSegment(False, b"sendernn", bytes(8), STREAM_OCTETS + 1, 0, b""),
        HandshakeSegment(False, b"sendernn", bytes(8), 0, STREAM_OCTETS, b"x"),
        HandshakeSegment(False, b"sendernn", bytes(8), 0, 0, bytes(DATA_OCTETS + 1)),
    ],
)
def test_what_no_peer_sends_is_malformed(segment):
    assert SegmentCodec(TWO, ONE).parse(CODEC.pack(segment)) == "malformed"

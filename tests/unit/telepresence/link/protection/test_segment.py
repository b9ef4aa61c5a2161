from random import Random

import pytest
from hypothesis import given
from hypothesis import strategies as st

from telepresence.link.protection.identity import MachineKey
from telepresence.link.protection.segment import (
    DATA_OCTETS,
    SEGMENT_OCTETS,
    SEGMENT_OVERHEAD_OCTETS,
    STREAM_OCTETS,
    HandshakeSegment,
    IncomingStream,
    OutgoingStream,
    SegmentCodec,
)

ONE, TWO, THREE = (MachineKey.from_seed(bytes([n] * 32)).identity for n in range(3))
CODEC = SegmentCodec(ONE, TWO)
SEGMENT = HandshakeSegment(True, b"sendernn", b"receiver", 7, 9, b"octets")


def test_only_the_peer_that_knows_both_identities_is_read():
    datagram = CODEC.pack(SEGMENT)
    assert len(datagram) == SEGMENT_OVERHEAD_OCTETS + 6
    assert SegmentCodec(TWO, ONE).parse(datagram) == SEGMENT
    for codec in (CODEC, SegmentCodec(THREE, ONE), SegmentCodec(TWO, THREE)):
        assert codec.parse(datagram) == "unauthenticated"


@pytest.mark.parametrize("bit", range(8 * (SEGMENT_OVERHEAD_OCTETS + 6)))
def test_a_flipped_bit_is_noticed(bit):
    datagram = bytearray(CODEC.pack(SEGMENT))
    datagram[bit // 8] ^= 1 << bit % 8
    assert SegmentCodec(TWO, ONE).parse(bytes(datagram)) == "unauthenticated"


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


@given(st.binary(max_size=5 * DATA_OCTETS), st.integers(0, 2**32))
def test_a_stream_arrives_whatever_the_path_does(octets, seed):
    random = Random(seed)
    out, into, got = OutgoingStream(), IncomingStream(), b""
    cut = random.randrange(len(octets) + 1)
    out.add(octets[:cut])
    for attempt in range(200):
        pieces = []
        while (piece := out.next_piece()) is not None:
            assert len(piece[1]) <= SEGMENT_OCTETS
            pieces += [piece] * random.choice((0, 1, 1, 2))
        random.shuffle(pieces)
        for piece in pieces:
            got += into.handle_piece(*piece)
        if random.random() < 0.7:
            out.handle_acknowledged(into.received)
        if attempt == 2:
            out.add(octets[cut:])
        if attempt > 2 and not out.outstanding:
            break
        out.repeat()
    assert got == octets


def test_an_acknowledgement_of_what_was_never_sent_is_no_news():
    out = OutgoingStream()
    out.add(b"12345")
    assert out.handle_acknowledged(3)
    assert not out.handle_acknowledged(3)
    assert not out.handle_acknowledged(2)
    assert not out.handle_acknowledged(6)
    assert out.outstanding

"""Octets that arrive whole and in order over any path, and sets of them."""

from random import Random

from hypothesis import given
from hypothesis import strategies as st

from telepresence.link.octet_streams import IncomingOctets, OutgoingOctets, RangeSet

PIECE_OCTETS = 100


@given(st.integers(0, 5 * PIECE_OCTETS), st.integers(0, 2**32))
def test_a_stream_arrives_whatever_the_path_does(size, seed):
    random = Random(seed)
    octets = random.randbytes(size)
    out, into, got = OutgoingOctets(), IncomingOctets(16), b""
    cut = random.randrange(len(octets) + 1)
    out.add(octets[:cut])
    for attempt in range(200):
        pieces = []
        while (piece := out.next_piece(PIECE_OCTETS)) is not None:
            assert len(piece[1]) <= PIECE_OCTETS
            pieces += [piece] * random.choice((0, 1, 1, 2))
        random.shuffle(pieces)
        for piece in pieces:
            got += into.handle_piece(*piece)
        if random.random() < 0.7:
            out.handle_acknowledged(into.received)
        if attempt == 2:
            out.add(octets[cut:])
        if attempt > 2 and out.base == out.end:
            break
        out.handle_lost(0, out.sent)
    assert got == octets and into.received == len(octets)


def test_an_acknowledgement_of_what_was_never_sent_is_no_news():
    out = OutgoingOctets()
    out.add(b"12345")
    assert out.handle_acknowledged(3)
    assert not out.handle_acknowledged(3)
    assert not out.handle_acknowledged(2)
    assert not out.handle_acknowledged(6)
    assert out.base < out.end


def test_what_was_lost_goes_first_and_more_only_up_to_the_limit():
    out = OutgoingOctets(bytes(range(100)))
    assert out.next_piece(30, 50) == (0, bytes(range(30)))
    assert out.next_piece(30, 50) == (30, bytes(range(30, 50)))
    assert out.next_piece(30, 50) is None and not out.lost
    out.handle_acknowledged(10)
    # Not what was acknowledged, and not what comes anyway.
    out.handle_lost(0, 20)
    out.handle_lost(40, 70)
    assert [out.next_piece(30, 60) for _ in range(3)] == [
        (10, bytes(range(10, 20))),
        (40, bytes(range(40, 50))),
        (50, bytes(range(50, 60))),
    ]
    out.handle_lost(10, 60)
    out.handle_acknowledged(58)
    assert out.next_piece(30) == (58, bytes((58, 59)))
    assert out.cut() == bytes((58, 59)) and out.next_piece(30) is None


def test_a_gap_is_what_is_missing_before_the_first_early_piece():
    incoming = IncomingOctets(2)
    assert incoming.handle_piece(5, b"fg") == b"" and incoming.gap == 5
    assert incoming.handle_piece(3, b"de") == b"" and incoming.gap == 3
    # No room for a third one.
    assert incoming.handle_piece(9, b"j") == b""
    assert incoming.handle_piece(0, b"abcd") == b"abcdefg"
    assert (incoming.received, incoming.gap) == (7, 0)


def test_ranges_are_a_set_of_octets():
    random, ranges, octets = Random(3), RangeSet(), set()
    for _ in range(500):
        start = random.randrange(300)
        end = start + random.randrange(20)
        new = set(range(start, end)) - octets
        assert ranges.add(start, end) == len(new)
        octets |= new
        if random.random() < 0.3 and ranges:
            taken = set(range(*ranges.take(7)))
            assert taken <= octets
            octets -= taken
        gaps = {at for gap in ranges.missing(320, 1_000) for at in range(*gap)}
        assert gaps == set(range(320)) - octets

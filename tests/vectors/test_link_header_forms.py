"""Contexts and compressed headers octet by octet, computed by hand from docs/link-format.md."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from telepresence.link.compression.header_compression import RtpDecompressor
from telepresence.link.compression.rtp_forms import (
    CONTEXT_OCTETS,
    KIND_CONTEXT,
    HeaderContext,
    RtpForms,
    parse_context,
    residue_octets,
)
from telepresence.link.flows import video_flow, voice_flow

VIDEO = video_flow("video")

#: 30 pictures a second of one packet each, 3000 ticks apart, sent at frame 1000.
CONTEXT = HeaderContext(
    number=5,
    count=1000,
    marker=1,
    payload_type=96,
    sequence=65_534,
    timestamp=0xFFFF_F000,
    ssrc=0x1122_3344,
    period=3000 * 64,
    rate=16,
    phase=-2,
    index=3,
    lead=-3,
)
CONTEXT_HEX = "05 e0 fffe fffff000 11223344 02ee00 10 fffe dd"


def test_a_context_octet_by_octet():
    assert CONTEXT.pack() == bytes.fromhex(CONTEXT_HEX)
    assert len(CONTEXT.pack()) == CONTEXT_OCTETS == 19
    assert parse_context(bytes.fromhex(CONTEXT_HEX), 1000) == CONTEXT
    assert parse_context(bytes(18), 0) is None


# 100 slots later 9000 ticks have passed. The context waited 3 leads of 180 ticks less than usual.
# So 8460 ticks are due, and the nearest grid point is the third: timestamp + 9000 - 2.
@pytest.mark.parametrize(
    ("kind", "residue", "marker", "sequence", "timestamp"),
    [
        (4, "", 1, 1, 0x1326),
        # 0x1325 = 4901 = 2 modulo 3; marker 0, index 3 + 3 = 2 modulo 4, sequence 65 535.
        (5 + 2, "5f", 0, 65_535, 0x1325),
        (5 + 0, "c1", 1, 1, 0x1326),
        # The grid point before, and a tick after it; the third packet of that picture.
        (5 + 1, "a2", 1, 2, 0x1326 - 3000 + 1),
        (8 + 2, "e0", 1, 1, 0x12E0),
        (8 + 1, "6e", 1, 0, 0x076E),
        # Marker 1, sequence 4 low bits 0101, timestamp 13 low bits of 0x1400.
        (12 + 2, "b400", 1, 5, 0x1400),
        (12 + 1, "f000", 0, 65_535, 0x1000),
        # The limits of the windows: the grid point -128 and +127; 12 before number 1 and 19 after
        # it; 5120 ticks before the due time, at the first grid point, 6 before its number 65 535.
        (8 + 2, "a6", 1, 1, 0x1326 - 128),
        (8 + 2, "a5", 1, 1, 0x1326 + 127),
        (5 + 0, "d5", 1, 65_525, 0x1326),
        (5 + 0, "d4", 1, 20, 0x1326),
        (12 + 1, "3d0c", 0, 65_529, 0xFFFF_FD0C),
    ],
)
def test_headers_octet_by_octet(kind, residue, marker, sequence, timestamp):
    decompressor = RtpDecompressor(VIDEO, 1_000_000)
    first = decompressor.decompress(KIND_CONTEXT, bytes.fromhex(CONTEXT_HEX) + b"first", 1000)
    assert first == bytes.fromhex("80 e0 fffe fffff000 11223344") + b"first"
    assert decompressor.context_id == 5
    packet = decompressor.decompress(kind, bytes.fromhex(residue) + b"payload", 1100)
    header = bytes((0x80, marker << 7 | 96)) + sequence.to_bytes(2, "big")
    header += timestamp.to_bytes(4, "big") + bytes.fromhex("11223344")
    assert packet == header + b"payload"


octets = st.binary(min_size=CONTEXT_OCTETS, max_size=CONTEXT_OCTETS)


@given(octets)
def test_any_context_packs_to_what_was_parsed(body):
    context = parse_context(body, 7)
    if context is None:
        assert body[12:15] == bytes(3)
    else:
        assert context.pack() == body


@given(octets, st.integers(4, 15), st.binary(max_size=3), st.integers(0, 1 << 26))
def test_any_residue_gives_fields_or_is_too_short(body, kind, residue, slots):
    context = parse_context(body, 0)
    if context is None:
        return
    for flow in (VIDEO, voice_flow("voice")):
        fields = RtpForms(flow, 1_000_000).unpack(kind, residue, context, slots)
        if len(residue) < residue_octets(kind):
            assert fields is None
            continue
        marker, sequence, timestamp = fields
        assert marker in (0, 1)
        assert 0 <= sequence < 1 << 16
        assert 0 <= timestamp < 1 << 32


@given(octets, st.integers(0, 1 << 20), st.integers(4, 15), st.binary(min_size=2, max_size=2))
def test_restored_fields_pack_into_the_same_header(body, slots, kind, residue):
    """Each form's packing is the inverse of its parsing, for any context."""
    context = parse_context(body, 0)
    if context is None:
        return
    forms = RtpForms(VIDEO, 1_000_000)
    residue = residue[: residue_octets(kind)]
    fields = forms.unpack(kind, residue, context, slots)
    packed = [pack(*fields, index) for pack in forms.packers for index in range(4)]
    if kind in (5, 6, 7) and (kind - 5, residue[0]) != (fields[2] % 3, residue[0]):
        # At the wrap of the timestamp, thirds do not continue; such a header is never sent.
        assert min(fields[2], (1 << 32) - 1 - fields[2]) < 2
        return
    assert (kind, residue) in packed

"""Compressed headers octet by octet, by hand from docs/link-format.md; and each rule's window."""

from itertools import product

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
SLOT_NS = 1_000_000
FORMS = RtpForms(video_flow("video"), SLOT_NS)
BARE, SHORT, NEAR, LONG, WIDE, NONE = range(6)
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
    data = bytes.fromhex(CONTEXT_HEX)
    assert CONTEXT.pack() == data and len(data) == CONTEXT_OCTETS == 19
    assert parse_context(data + b"payload", 1000) == CONTEXT
    assert parse_context(data[:-1], 1000) is None
    # A source without a period has no grid.
    assert parse_context(data[:12] + bytes(3) + data[15:], 1000) is None


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
    decompressor = RtpDecompressor(VIDEO, SLOT_NS)
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


@given(octets, st.integers(0, 1 << 26), st.integers(4, 15), st.binary(max_size=3))
def test_restored_fields_pack_into_the_same_header(body, slots, kind, residue):
    """Each form's packing is the inverse of its parsing, for any context."""
    context = parse_context(body, 0)
    if context is None:
        return
    fields = FORMS.unpack(kind, residue, context, slots)
    if len(residue) < residue_octets(kind):
        assert fields is None
        return
    marker, sequence, timestamp = fields
    assert marker in (0, 1) and 0 <= sequence < 1 << 16 and 0 <= timestamp < 1 << 32
    residue = residue[: residue_octets(kind)]
    packed = [pack(*fields, index) for pack in FORMS.packers for index in range(4)]
    if kind in (5, 6, 7) and kind - 5 != timestamp % 3:
        # At the wrap of the timestamp, thirds do not continue; such a header is never sent.
        assert min(timestamp, (1 << 32) - 1 - timestamp) < 2
        return
    assert kind == 3 or (kind, residue) in packed


def context(**changes):
    """Pictures of three packets at 30 Hz; 200 slots of 90 ticks later, the sixth is due."""
    table = {
        "number": 1,
        "count": 1000,
        "marker": 0,
        "payload_type": 96,
        "sequence": 100,
        "timestamp": 50_000,
        "ssrc": 5,
        "period": 3000 * 64,
        "rate": 48,
        "phase": 0,
        "index": 1,
        "lead": 0,
    }
    return HeaderContext(**{**table, **changes})


#: On the grid; and through all wraps, at 29.97 Hz and 2.5 packets, off the grid, after a wait.
SOURCES = [
    context(),
    context(
        marker=1,
        sequence=65_530,
        timestamp=(1 << 32) - 9000,
        period=3003 * 64 + 21,
        rate=40,
        phase=-7,
        index=3,
        lead=2,
    ),
]


def sent(source, step, beside, error, marker):
    """The form chosen for a packet, by its place on the grid; checks that it comes back exactly."""
    ticks = (step * source.period + 32) // 64
    packets = (step * source.rate + 8) // 16
    timestamp = (source.timestamp + source.phase + ticks + beside) % (1 << 32)
    fields = marker, (source.sequence + packets + error) % 65536, timestamp
    form, late = FORMS.shortest(source, 1200, fields)
    due = (6 * source.rate + 8) // 16
    assert late == packets + error - due
    if form < NONE:
        kind, residue = FORMS.packers[form](*fields, source.index + step)
        assert len(residue) == residue_octets(kind) == (0, 1, 1, 2, 3)[form]
        assert FORMS.unpack(kind, residue + b"rest", source, 1200) == fields
        if residue:
            assert FORMS.unpack(kind, residue[:-1], source, 1200) is None
    return form


def is_long(source, step, beside):
    due = 18_000 + source.lead * 180
    off = source.phase + (step * source.period + 32) // 64 + beside
    return -5120 <= off - due <= 3071


@pytest.mark.parametrize("source", SOURCES)
def test_the_cheapest_rule_whose_window_holds_is_taken(source):
    steps = (3, 4, 5, 6, 7, 8)
    besides = (-129, -128, -2, -1, 0, 1, 2, 127, 128)
    errors = (-13, -12, -7, -6, -1, 0, 1, 9, 10, 19, 20)
    for step, beside, error, other in product(steps, besides, errors, (False, True)):
        usual = not other and not error
        near_in_time = 4 <= step <= 7
        if usual and step == 6 and not beside:
            form = BARE
        elif near_in_time and abs(beside) <= 1 and -12 <= error <= 19:
            form = SHORT
        elif near_in_time and usual and -128 <= beside <= 127:
            form = NEAR
        # 5120 ticks before the due time are 1.7 periods, and 3071 after it hardly more than one.
        elif -6 <= error <= 9 and is_long(source, step, beside):
            form = LONG
        else:
            form = WIDE
        found = sent(source, step, beside, error, source.marker ^ other)
        assert found == form, (step, beside, error, other)


@pytest.mark.parametrize(
    ("late_ticks", "form"),
    [
        *[(-5121, WIDE), (-5120, LONG), (3071, LONG), (3072, WIDE)],
        *[(-49_153, NONE), (-49_152, WIDE), (16_383, WIDE), (16_384, NONE)],
    ],
)
@pytest.mark.parametrize("marker", [0, 1])
def test_the_long_and_the_wide_rule_have_windows_of_time(late_ticks, form, marker):
    """Half a period off the grid, so that no cheaper rule fits; as many packets as are due."""
    step, beside = divmod(18_000 + late_ticks, 3000)
    if beside > 1500:
        step, beside = step + 1, beside - 3000
    source = context()
    error = 18 - 3 * step if abs(late_ticks) > 5121 else 4
    assert sent(source, step, beside, error, marker) == form


@pytest.mark.parametrize(
    ("late_packets", "form"), [(-65, NONE), (-64, WIDE), (63, WIDE), (64, NONE)]
)
def test_the_wide_rule_has_a_window_of_packets(late_packets, form):
    assert sent(context(), 6, 700, late_packets, 0) == form


def test_time_is_counted_in_whole_ticks():
    voice = RtpForms(voice_flow("voice"), 333_333)
    assert [FORMS.slots_in_ticks(slots) for slots in (0, 1, 7)] == [0, 90, 630]
    assert [voice.slots_in_ticks(slots) for slots in (1, 3, 3000)] == [15, 47, 47_999]
    # A wait is told in 2 ms.
    assert (FORMS.lead_ticks, voice.lead_ticks) == (180, 96)
    assert [residue_octets(kind) for kind in range(3, 16)] == [3, 0, 1, 1, 1, 1, 1, 1, 1] + [2] * 4

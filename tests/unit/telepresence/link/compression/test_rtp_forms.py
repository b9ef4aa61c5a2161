"""Each rule of compressed headers: its window to the tick, and what comes back out of its bits."""

from itertools import product

import pytest
from hypothesis import given
from hypothesis import strategies as st

from telepresence.link.compression.header_compression import RtpSource
from telepresence.link.compression.rtp_forms import (
    HeaderContext,
    RtpForms,
    parse_context,
    residue_octets,
)
from telepresence.link.flows import video_flow, voice_flow

SLOT_NS = 1_000_000
FORMS = RtpForms(video_flow("video"), SLOT_NS)
BARE, SHORT, NEAR, LONG, WIDE, NONE = range(6)

CONTEXTS = st.builds(
    HeaderContext,
    number=st.integers(0, 255),
    count=st.just(77),
    marker=st.integers(0, 1),
    payload_type=st.integers(0, 127),
    sequence=st.integers(0, 65535),
    timestamp=st.integers(0, (1 << 32) - 1),
    ssrc=st.integers(0, (1 << 32) - 1),
    period=st.integers(1, (1 << 24) - 1),
    rate=st.integers(0, 255),
    phase=st.integers(-32768, 32767),
    index=st.integers(0, 3),
    lead=st.integers(-32, 31),
)


@given(CONTEXTS)
def test_a_context_is_read_as_it_was_written(context):
    data = context.pack()
    assert len(data) == 19 and parse_context(data + b"payload", 77) == context
    assert parse_context(data[:-1], 77) is None
    # A source without a period has no grid.
    assert parse_context(data[:12] + bytes(3) + data[15:], 77) is None


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


def is_long(source, step, beside):
    due = 18_000 + source.lead * 180
    off = source.phase + (step * source.period + 32) // 64 + beside
    return -5120 <= off - due <= 3071


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


def video_source(pictures, *, packets=3, step=3000, first=(65_500, (1 << 32) - 8000), waits=()):
    """A source after so many pictures, each sent ten slots after its timestamp."""
    sequence, timestamp = first
    source = None
    for picture in range(pictures):
        for packet in range(packets):
            number = (sequence + picture * packets + packet) % 65536
            at = (timestamp + picture * step) % (1 << 32)
            count = 1000 + picture * step // 90 + (waits[picture] if waits else 0)
            if source is None:
                source = RtpSource(video_flow("video"), FORMS, number, at)
            source.handle_packet(number, at, count)
    return source


@pytest.mark.parametrize(("step", "packets"), [(3000, 3), (1500, 1), (3600, 5)])
def test_a_context_has_what_its_source_does(step, packets):
    source = video_source(150, packets=packets, step=step)
    found = source.context(9, 4321, 1, 96, 0xABCD)
    assert (found.number, found.count, found.marker, found.payload_type, found.ssrc) == (
        *(9, 4321, 1, 96, 0xABCD),
    )
    assert (found.period, found.rate) == (step * 64, packets * 16)
    assert (found.phase, found.lead, found.index) == (0, 0, 149 % 4)
    assert found.sequence == (65_500 + 150 * packets - 1) % 65536
    assert found.timestamp == ((1 << 32) - 8000 + 149 * step) % (1 << 32)
    # It says where the next packets are: all of the next pictures come back from the context.
    for ahead in (1, 2, 50):
        kind_and_residue = FORMS.packers[SHORT](
            0,
            (found.sequence + ahead * packets) % 65536,
            (found.timestamp + ahead * step) % (1 << 32),
            found.index + ahead,
        )
        count = 4321 + round(ahead * step / 90)
        fields = FORMS.unpack(*kind_and_residue, found, count)
        assert fields[1:] == (
            (found.sequence + ahead * packets) % 65536,
            (found.timestamp + ahead * step) % (1 << 32),
        )


def test_an_exact_source_is_known_after_four_steps_and_any_other_after_many():
    assert [video_source(n).known for n in (1, 4, 5)] == [False, False, True]
    uneven = RtpSource(video_flow("video"), FORMS, 0, 0)
    known = []
    for picture in range(1, 40):
        uneven.handle_packet(picture, picture * 3000 + 40 * (-1) ** picture, picture * 33)
        known.append(uneven.known)
    assert known.index(True) == 31
    # A flow with a stride is known at once.
    assert RtpSource(voice_flow("voice"), RtpForms(voice_flow("voice"), SLOT_NS), 0, 0).known


def test_a_longer_wait_than_usual_is_the_lead_of_a_context():
    waits = [10] * 40
    for wait, lead in ((10, 0), (14, 2), (6, -2), (72, 31), (500, 31)):
        source = video_source(40, packets=1, waits=[*waits[:-1], wait])
        assert source.context(1, 1000, 0, 96, 1).lead == lead, wait


def test_blocks_of_another_length_are_followed_after_four_of_them():
    flow = voice_flow("voice")
    forms = RtpForms(flow, SLOT_NS)
    source = RtpSource(flow, forms, 0, 0)
    periods, timestamp = [], 0
    for number, step in enumerate([960] * 3 + [480] * 5 + [5760] * 4 + [6001] * 5):
        timestamp += step
        source.handle_packet(number + 1, timestamp, timestamp // 48)
        periods.append(source.context(1, 0, 0, 97, 1).period // 64)
    # A block of sound is at most 120 ms long (RFC 6716): 5760 ticks.
    assert periods == [960] * 6 + [480] * 5 + [5760] * 6

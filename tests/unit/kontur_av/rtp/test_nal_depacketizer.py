"""Which access units come out of packets with NAL units, and what they say of losses."""

import pytest
from rtp_packets import received

from kontur_av.rtp.annex_b import join_annex_b, split_annex_b
from kontur_av.rtp.nal_depacketizer import NalDepacketizer
from kontur_av.rtp.nal_formats import H264, H265

SPS, PPS = b"\x67\x42\xc0\x1e", b"\x68\xce\x3c\x80"
#: Slices whose first_mb_in_slice is 0, and one that continues a picture.
IDR, SLICE, LATER_SLICE = b"\x65\x88\x11", b"\x41\x88\x22", b"\x41\x22\x33"
#: A slice in parts of which none is the whole.
LONG = b"\x41\x88" + bytes([7]) * 30
PARTS = H264.packetize([LONG], 20)


def through(packets, depacketizer=None, **options):
    """Return the units of packets, and of the end of the stream."""
    depacketizer = depacketizer or NalDepacketizer(H264, **options)
    units = []
    for packet in packets:
        depacketizer.handle_packet(packet)
        units += iter(depacketizer.next_event, None)
    depacketizer.handle_timeout(10**18)
    return [*units, *iter(depacketizer.next_event, None)]


def nals(units):
    return [split_annex_b(unit.data) for unit in units]


def pictures(*payloads):
    """Return packets, each of them a whole picture."""
    return [received(one, number, timestamp=3000 * number) for number, one in enumerate(payloads)]


def unmarked(*payloads):
    return [received(one, number, marker=False) for number, one in enumerate(payloads)]


def test_sets_of_the_sdp_go_before_the_first_picture_and_every_later_idr():
    depacketizer = NalDepacketizer(H264, [SPS, PPS])
    own = H264.packetize([SPS, PPS, IDR])[0]
    units = through(pictures(SLICE, SLICE, IDR, SLICE, own), depacketizer)
    key = [SPS, PPS, IDR]
    assert nals(units) == [[SPS, PPS, SLICE], [SLICE], key, [SLICE], key]
    assert [unit.keyframe for unit in units] == [False, False, True, False, True]
    assert not any(unit.damaged or unit.lost_before for unit in units)
    # The stream has brought its own, and the SDP may be older.
    assert nals(through([received(IDR, 9, ssrc=8)], depacketizer)) == [[IDR]]


@pytest.mark.parametrize("marked", [True, False])
def test_the_first_picture_waits_only_if_the_marker_may_be_on_each_slice(marked):
    depacketizer = NalDepacketizer(H264, marked=marked)
    for ssrc in (7, 8):
        depacketizer.handle_packet(received(IDR, 0, ssrc=ssrc))
        # The second sender's first packet ends the picture of the first one.
        assert (depacketizer.next_event() is not None) is (marked or ssrc == 8)
        assert (depacketizer.poll_timeout() is None) is marked


@pytest.mark.parametrize(
    ("marker", "wait_ms", "markers_end"), [(True, 40, True), (False, 500, False)]
)
def test_the_first_picture_waits_40_ms_with_a_marker_and_500_without(marker, wait_ms, markers_end):
    depacketizer = NalDepacketizer(H264)
    depacketizer.handle_packet(received(SLICE, 0, received_ns=7, marker=marker))
    due_ns = 7 + wait_ms * 1_000_000
    assert depacketizer.poll_timeout() == due_ns
    depacketizer.handle_timeout(due_ns - 1)
    assert depacketizer.next_event() is None
    depacketizer.handle_timeout(due_ns)
    assert not depacketizer.next_event().damaged and depacketizer.poll_timeout() is None
    # From then on the marker ends pictures, if it had one.
    depacketizer.handle_packet(received(SLICE, 1, timestamp=3000))
    assert (depacketizer.next_event() is not None) is markers_end


def test_each_picture_is_counted_once():
    depacketizer = NalDepacketizer(H264)
    packets = [
        received(SLICE, 0, timestamp=0),
        # The second part is lost, so nothing of this picture comes out.
        received(PARTS[0], 1, timestamp=1, marker=False),
        received(SLICE, 3, timestamp=2, lost_before=1),
        received(b"\x7f", 4, timestamp=3),
        # The first part of a slice, then the picture's second slice.
        received(PARTS[0], 5, timestamp=4, marker=False, received_ns=100),
        received(LATER_SLICE, 7, timestamp=4, lost_before=1, received_ns=107),
    ]
    units = through(packets, depacketizer)
    assert [(unit.timestamp, unit.damaged, unit.lost_before) for unit in units] == [
        *((0, False, 0), (2, False, 1), (4, True, 0))
    ]
    assert [(unit.first_received_ns, unit.received_ns) for unit in units][-1] == (100, 107)
    counts = depacketizer.units, depacketizer.units_damaged, depacketizer.garbage
    assert counts == (3, 2, 1)


@pytest.mark.parametrize(
    ("lost", "counted"),
    [([4], 1), ([4, 5, 6], 3), ([4, 8], 2), ([1], 1), ([0, 9], 0), (range(2, 8), 6)],
)
@pytest.mark.parametrize("first", [0, 2**32 - 12_000])
def test_pictures_that_are_lost_whole_count_as_damaged(lost, counted, first):
    depacketizer = NalDepacketizer(H264, marked=True)
    came = [number for number in range(10) if number not in lost]
    for before, number in zip([came[0] - 1, *came], came, strict=False):
        stamp = (first + 3000 * number) % 2**32
        depacketizer.handle_packet(
            received(SLICE, number, timestamp=stamp, lost_before=number - before - 1)
        )
    # A lost SEI before a picture, and a pause of the sender, are no pictures.
    for number, lost_before in ((10, 1), (40, 0)):
        stamp = (first + 3000 * number) % 2**32
        depacketizer.handle_packet(
            received(SLICE, number, timestamp=stamp, lost_before=lost_before if 9 in came else 0)
        )
    assert (depacketizer.units, depacketizer.units_damaged) == (len(came) + 2, counted)


def test_a_picture_joined_in_its_middle_is_damaged():
    depacketizer = NalDepacketizer(H264)
    units = through(pictures(LATER_SLICE, LATER_SLICE, SLICE), depacketizer)
    # Only where its head may be missing: later a slice of another form is the sender's affair.
    assert [unit.damaged for unit in units] == [True, False, False]
    for number, why in ((5, {"lost_before": 2}), (6, {"restart": True})):
        packet = received(LATER_SLICE, number, timestamp=3 * number, **why)
        (unit,) = through([packet], depacketizer)
        assert unit.damaged


def test_losses_damage_the_picture_that_they_fall_into_or_count_for_the_next_one():
    packets = [
        received(SLICE, 0, marker=False),
        received(LATER_SLICE, 2, lost_before=1),
        received(SLICE, 3, timestamp=3000, marker=False),
        # The end of the second and the beginning of the third are lost.
        received(LATER_SLICE, 6, timestamp=6000, lost_before=2),
        received(SLICE, 7, timestamp=9000),
        # Packets without content.
        received(b"", 9, timestamp=12_000, lost_before=1),
        received(b"\0", 11, timestamp=12_000, lost_before=1),
        received(SLICE, 13, timestamp=12_000, lost_before=1),
        received(SLICE, 14, timestamp=15_000),
        # Without their first part the others belong to no NAL unit.
        *(received(part, 16 + n, timestamp=18_000, marker=n == 1, lost_before=n == 0)
          for n, part in enumerate(PARTS[1:])),
        received(SLICE, 18, timestamp=21_000),
    ]  # fmt: skip
    units = through(packets)
    assert [(unit.timestamp // 3000, unit.damaged, unit.lost_before) for unit in units] == [
        *((0, True, 0), (1, True, 0), (2, True, 2), (3, False, 0), (4, False, 3), (5, False, 0)),
        (7, False, 1),
    ]
    # A restart damages the picture of the old source.
    parts = H264.packetize([SLICE, LONG], 20)
    packets = [received(parts[0], 0, marker=False), received(SLICE, 900, ssrc=9, restart=True)]
    assert [(unit.data, unit.damaged) for unit in through(packets)] == [
        *((join_annex_b([SLICE]), True), (join_annex_b([SLICE]), False))
    ]


def test_an_access_unit_larger_than_allowed_is_dropped_and_a_loss_before_the_next():
    for most, count in ((len(SLICE) + 9, 0), (len(SLICE) + 10, 1)):
        small = NalDepacketizer(H264, max_unit_octets=most)
        large = SLICE + bytes(9) + b"\1"
        units = through(pictures(SLICE, large, SLICE, SLICE), small)
        found = {unit.timestamp: unit.lost_before for unit in units}
        assert found == {0: 0, 6000: 1 - count, 9000: 0} | ({3000: 0} if count else {})
        assert (small.garbage, small.units) == (1 - count, 3 + count)


def test_a_sender_that_marks_each_slice_costs_no_picture():
    sent = [
        received(unit, number, timestamp=number // 2 * 3000, received_ns=number // 2)
        for number, unit in enumerate([SLICE, LATER_SLICE] * 4)
    ]
    units = through(sent)
    assert nals(units) == [[SLICE, LATER_SLICE]] * 4
    assert not any(unit.damaged for unit in units)
    # Even if markers were believed at first: then the first two slices are two units.
    units = through(sent[:6], marked=True)
    assert nals(units)[-2:] == [[SLICE, LATER_SLICE]] * 2
    assert not units[-1].damaged


@pytest.mark.parametrize("garbage", [b"\x7f", b"\x7c\x01\x88"])
def test_garbage_within_a_picture_damages_it(garbage):
    depacketizer = NalDepacketizer(H264)
    packets = [
        # No payload, or a later part of nothing.
        *unmarked(SLICE, garbage),
        received(LATER_SLICE, 2),
        received(SLICE, 3, timestamp=3000),
    ]
    units = through(packets, depacketizer)
    assert [unit.damaged for unit in units] == [True, False]
    assert depacketizer.garbage == (garbage == b"\x7f")


@pytest.mark.parametrize("marked", [True, False])
def test_leading_and_key_pictures_of_hevc_are_told(marked):
    kinds = (21, 8, 9, 1, 19, 20, 16, 23)  # ITU-T H.265 table 7-1: CRA, RASL, TRAIL, IDR, BLA, IRAP
    packets = pictures(*(bytes((kind << 1, 1, 0x88)) for kind in kinds))
    units = through(packets, NalDepacketizer(H265, marked=marked))
    assert [kind for kind, unit in zip(kinds, units, strict=True) if not unit.keyframe] == [8, 9, 1]
    assert [kind for kind, unit in zip(kinds, units, strict=True) if unit.leading] == [8, 9]
    assert {unit.codec for unit in units} == {"h265"}


def test_a_picture_of_hevc_begins_with_its_first_slice_or_what_goes_ahead_of_it():
    # The first bit behind two octets of header tells a picture's first slice.
    packets = unmarked(*(bytes((2, 1, one)) for one in (0x80, 0x7F, 0xFF, 0x01)))
    assert [len(units) for units in nals(through(packets, NalDepacketizer(H265)))] == [2, 2]
    # ITU-T H.265 clause 7.4.2.4.4.
    for kind in (32, 33, 34, 35, 39, 41, 44):
        first, ahead = bytes.fromhex("020188"), bytes((kind << 1, 1, 9))
        units = through(unmarked(first, ahead, first), NalDepacketizer(H265))
        assert nals(units) == [[first], [ahead, first]]

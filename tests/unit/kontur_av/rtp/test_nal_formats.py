"""H.264 in RTP: what the headers say, and which access units come out."""

import pytest
from rtp_packets import received

from kontur_av.errors import ProtocolError
from kontur_av.rtp.annex_b import join_annex_b, split_annex_b
from kontur_av.rtp.nal_formats import H264, H265, parameter_sets_of
from kontur_av.rtp.nal_payload import NalDepacketizer

SPS, PPS = b"\x67\x42\xc0\x1e", b"\x68\xce\x3c\x80"
#: Slices whose first_mb_in_slice is 0, and one that continues a picture.
IDR, SLICE, LATER_SLICE = b"\x65\x88\x11", b"\x41\x88\x22", b"\x41\x22\x33"


def through(depacketizer, packets):
    units = []
    for packet in packets:
        depacketizer.handle_packet(packet)
        while (unit := depacketizer.next_event()) is not None:
            units.append(unit)
    depacketizer.handle_timeout(10**18)
    while (unit := depacketizer.next_event()) is not None:
        units.append(unit)
    return units


def pictures(*payloads, **changes):
    """Return packets, each of them a whole picture."""
    return [
        received(payload, number, timestamp=3000 * number, **changes)
        for number, payload in enumerate(payloads)
    ]


def test_an_aggregate_has_the_largest_nri_and_any_forbidden_bit():
    # RFC 6184 section 5.7.1: F is bit 7, NRI bits 5 and 6, the type 24.
    (payload,) = H264.packetize([b"\x06\x05", b"\x41\x88", b"\x21\x88"])
    assert payload[0] == 0x40 | 24
    (payload,) = H264.packetize([b"\x86\x05", b"\x67\x42"])
    assert payload[0] == 0x80 | 0x60 | 24


@pytest.mark.parametrize(
    ("octets", "parts"), [(1201, [600, 600]), (2397, [1198] * 2), (2399, [800, 799, 799])]
)
def test_a_large_unit_is_cut_into_equal_parts(octets, parts):
    unit = b"\x41" + bytes(1 + n % 255 for n in range(octets - 1))
    payloads = H264.packetize([unit], 1200)
    assert sorted((len(payload) - 2 for payload in payloads), reverse=True) == parts
    found = [H264.parse_payload(payload) for payload in payloads]
    assert b"".join(part.nal_units[0] for part in found) == unit
    assert [part.starts for part in found] == [True] + [False] * (len(parts) - 1)
    assert [part.ends for part in found] == [False] * (len(parts) - 1) + [True]


def test_units_share_a_payload_as_long_as_they_fit():
    units = [b"\x41" + bytes([n] * 3) for n in range(1, 4)]
    # One octet for the aggregate, two for each length.
    assert [len(payload) for payload in H264.packetize(units, 19)] == [19]
    assert [len(payload) for payload in H264.packetize(units, 18)] == [13, 4]
    assert [len(payload) for payload in H264.packetize([bytes([0x41] * 8)], 8)] == [8]


@pytest.mark.parametrize("most", [0, 7])
def test_payloads_too_small_for_headers_are_refused(most):
    with pytest.raises(ValueError, match="at least 8"):
        H264.packetize([SLICE], most)


@pytest.mark.parametrize("unit", [b"", b"\x60", b"\x78\x01", b"\x7c\x01"])
def test_a_unit_that_rtp_cannot_carry_is_refused(unit):
    with pytest.raises(ValueError, match="cannot carry"):
        H264.packetize([unit])


def test_sets_of_the_sdp_go_before_the_first_picture_and_every_later_idr():
    depacketizer = NalDepacketizer(H264, [SPS, PPS])
    own = H264.packetize([SPS, PPS, IDR])[0]
    units = through(depacketizer, pictures(SLICE, SLICE, IDR, SLICE, own))
    assert [split_annex_b(unit.data) for unit in units] == [
        [SPS, PPS, SLICE],
        [SLICE],
        [SPS, PPS, IDR],
        [SLICE],
        [SPS, PPS, IDR],
    ]
    assert [unit.keyframe for unit in units] == [False, False, True, False, True]
    assert not any(unit.damaged or unit.lost_before for unit in units)
    # The stream has brought its own, and the SDP may be older.
    (unit,) = through(depacketizer, [received(IDR, 9, ssrc=8)])
    assert split_annex_b(unit.data) == [IDR]


@pytest.mark.parametrize("marked", [True, False])
def test_the_first_picture_waits_only_if_the_marker_may_be_on_each_slice(marked):
    depacketizer = NalDepacketizer(H264, marked=marked)
    for ssrc in (7, 8):
        depacketizer.handle_packet(received(IDR, 0, ssrc=ssrc))
        unit = depacketizer.next_event()
        # The second sender's first packet ends the picture of the first one.
        assert (unit is not None) is (marked or ssrc == 8)
        assert (depacketizer.poll_timeout() is None) is marked


def test_each_picture_is_counted_once():
    depacketizer = NalDepacketizer(H264)
    whole, cut = H264.packetize([SLICE]), H264.packetize([b"\x41\x88" + bytes([7]) * 30], 20)
    packets = [
        received(whole[0], 0, timestamp=0),
        # The second part is lost, so nothing of this picture is left.
        received(cut[0], 1, timestamp=1, marker=False),
        received(whole[0], 3, timestamp=2, lost_before=1),
        received(b"\x7f", 4, timestamp=3),
        # The first part of a slice, then the picture's second slice.
        received(cut[0], 5, timestamp=4, marker=False),
        received(LATER_SLICE, 7, timestamp=4, lost_before=1),
    ]
    units = through(depacketizer, packets)
    assert [(unit.timestamp, unit.damaged, unit.lost_before) for unit in units] == [
        (0, False, 0),
        (2, False, 1),
        (4, True, 0),
    ]
    assert (depacketizer.units, depacketizer.units_damaged) == (3, 1)
    assert depacketizer.garbage == 1


def test_a_unit_tells_when_its_first_and_its_last_packet_came():
    parts = H264.packetize([b"\x41\x88" + bytes([7]) * 60], 30)
    packets = [
        received(part, n, received_ns=100 + n, marker=n == len(parts) - 1)
        for n, part in enumerate(parts)
    ]
    (unit,) = through(NalDepacketizer(H264), packets)
    assert (unit.first_received_ns, unit.received_ns) == (100, 100 + len(parts) - 1)
    assert len(parts) > 2


def test_a_picture_joined_in_its_middle_is_damaged():
    depacketizer = NalDepacketizer(H264)
    units = through(depacketizer, pictures(LATER_SLICE, LATER_SLICE, SLICE))
    # Only where its head may be missing: later a slice of another form is the sender's affair.
    assert [unit.damaged for unit in units] == [True, False, False]
    (lost,) = through(depacketizer, [received(LATER_SLICE, 5, timestamp=9, lost_before=2)])
    assert lost.damaged
    (restarted,) = through(depacketizer, [received(LATER_SLICE, 6, timestamp=12, restart=True)])
    assert restarted.damaged


def test_a_picture_that_is_lost_with_its_first_packet_is_a_loss_before_the_next():
    depacketizer = NalDepacketizer(H264)
    parts = H264.packetize([b"\x41\x88" + bytes([7]) * 60], 30)
    packets = [
        received(H264.packetize([SLICE])[0], 0, timestamp=0),
        # The first part is lost. The others belong to no NAL unit.
        *(
            received(part, 2 + n, timestamp=1, marker=n == len(parts) - 2, lost_before=n == 0)
            for n, part in enumerate(parts[1:])
        ),
        received(H264.packetize([SLICE])[0], 9, timestamp=2),
    ]
    units = through(depacketizer, packets)
    assert [(unit.timestamp, unit.lost_before) for unit in units] == [(0, 0), (2, 1)]
    # Its successor has no loss before it.
    (after,) = through(depacketizer, [received(H264.packetize([SLICE])[0], 10, timestamp=3)])
    assert after.lost_before == 0


def test_a_picture_of_the_old_source_is_damaged_by_a_restart():
    parts = H264.packetize([SLICE, b"\x41\x22" + bytes([7]) * 30], 20)
    packets = [received(parts[0], 0, marker=False), received(SLICE, 900, ssrc=9, restart=True)]
    units = through(NalDepacketizer(H264), packets)
    assert [(unit.data, unit.damaged) for unit in units] == [
        (join_annex_b([SLICE]), True),
        (join_annex_b([SLICE]), False),
    ]


def test_an_access_unit_larger_than_allowed_is_dropped():
    unit = b"\x41\x88" + bytes([7]) * 40
    for most, count in ((42, 1), (41, 0)):
        depacketizer = NalDepacketizer(H264, max_unit_octets=most)
        found = through(depacketizer, pictures(unit, unit))
        assert len(found) == 2 * count
        assert depacketizer.garbage == 2 - 2 * count


@pytest.mark.parametrize("end", ["marker", "silence", "next unit", "next picture"])
def test_a_unit_whose_last_part_is_not_marked_is_whole(end):
    whole = b"\x41\x88" + bytes([7]) * 30
    parts = H264.packetize([whole], 20)
    parts[-1] = parts[-1][:1] + bytes([parts[-1][1] & ~0x40]) + parts[-1][2:]
    last = len(parts) - 1
    packets = [
        received(part, n, marker=end == "marker" and n == last) for n, part in enumerate(parts)
    ]
    units = [whole]
    if end == "next unit":
        packets.append(received(LATER_SLICE, last + 1))
        units.append(LATER_SLICE)
    if end == "next picture":
        packets.append(received(SLICE, last + 1, timestamp=3000))
    first = through(NalDepacketizer(H264, marked=end == "marker"), packets)[0]
    assert split_annex_b(first.data) == units
    assert not first.damaged


@pytest.mark.parametrize(
    ("payload", "units"),
    [
        ("41 88", ["4188"]),
        # Zeros behind a NAL unit, and start codes before or within a payload, as FFmpeg takes them.
        ("41 88 00 00", ["4188"]),
        ("00", []),
        ("00 0000", []),
        ("000001 41 88", ["4188"]),
        ("00000001 41 88", ["4188"]),
        ("06 05 000001 41 88", ["0605", "4188"]),
        ("57 88", ["5788"]),  # type 23, the last that goes alone
        # STAP-A: octets at the end, a unit of none, and start codes are no NAL units.
        ("78 0002 4188", ["4188"]),
        ("78 0002 4188 00", ["4188"]),
        ("78 0002 4188 0002", ["4188"]),
        ("78 0000 0002 4188", ["4188"]),
        ("78 0005 000001 4188", ["4188"]),
        # FU-A that starts and ends, and one with its reserved bit.
        ("7c c1 88", ["6188"]),
        ("7c e1 88", ["6188"]),
        ("7c d7 88", ["7788"]),
    ],
)
def test_payloads_of_other_senders_are_read(payload, units):
    found = H264.parse_payload(bytes.fromhex(payload))
    assert found.nal_units == tuple(bytes.fromhex(one) for one in units)
    assert (found.is_part, found.starts, found.ends) == (False, True, True)


@pytest.mark.parametrize(
    ("payload", "reason"),
    [
        ("", "an empty payload"),
        ("0001", "without a NAL unit"),
        ("79 00 0002 4188", "of type 25"),
        ("7d 81 88", "of type 29"),
        ("78", "without content"),
        ("78 0000", "without content"),
        ("78 0003 4188", "cut or nested"),
        ("78 0002 7888", "cut or nested"),
        ("7c", "without its header"),
        ("7c 98", "with the header 0x98"),
    ],
)
def test_payloads_that_are_none_are_refused(payload, reason):
    with pytest.raises(ProtocolError, match=reason):
        H264.parse_payload(bytes.fromhex(payload))


@pytest.mark.parametrize(
    ("octets", "start", "end"), [("7c 81 88", 1, 0), ("7c 01 88", 0, 0), ("7c 41 88", 0, 1)]
)
def test_a_part_says_whether_it_is_the_first_or_the_last(octets, start, end):
    found = H264.parse_payload(bytes.fromhex(octets))
    assert (found.is_part, found.starts, found.ends) == (True, bool(start), bool(end))
    assert found.nal_units == (b"\x61\x88" if start else b"\x88",)


def test_parameter_sets_are_those_of_a_unit_with_an_sps():
    assert split_annex_b(H264.parameter_sets(join_annex_b([SPS, PPS, IDR]))) == [SPS, PPS]
    assert H264.parameter_sets(join_annex_b([PPS, IDR])) == b""
    assert parameter_sets_of(join_annex_b([PPS, SPS]), "h264") == join_annex_b([PPS, SPS])
    vps, sps = bytes.fromhex("40010c"), bytes.fromhex("420101")
    unit = join_annex_b([vps, sps, bytes.fromhex("260188")])
    assert parameter_sets_of(unit, "h265") == join_annex_b([vps, sps])
    assert parameter_sets_of(unit, "h264") == b""


def test_octets_before_a_start_code_and_zeros_are_no_nal_units():
    assert split_annex_b(b"") == split_annex_b(b"\x41\x88") == []
    code = b"\0\0\1"
    assert split_annex_b(b"\x09" + code + SPS + code + code + b"\0" + PPS) == [SPS, b"\0" + PPS]
    assert split_annex_b(code) == split_annex_b(code + bytes(3)) == []


def test_a_picture_ends_where_the_next_one_begins():
    """ITU-T H.264 clause 7.4.1.2.3: with a first slice, or what goes ahead of one."""
    for ahead in ([], [b"\x09\xf0"], [b"\x06\x05"], [SPS, PPS], [b"\x06\x05", SPS]):
        sent = [[SLICE, LATER_SLICE], [*ahead, SLICE], [*ahead, IDR, LATER_SLICE]]
        payloads = [unit for units in sent for unit in units]
        packets = [received(unit, number, marker=False) for number, unit in enumerate(payloads)]
        units = through(NalDepacketizer(H264), packets)
        assert [split_annex_b(unit.data) for unit in units] == sent
        assert not any(unit.damaged for unit in units)
        assert [unit.keyframe for unit in units] == [False, False, True]


def test_a_sender_that_dates_each_slice_is_understood():
    packets = [
        received(unit, number, timestamp=3000 * (number // 2) + number % 2, marker=bool(number % 2))
        for number, unit in enumerate([SLICE, LATER_SLICE] * 3)
    ]
    units = through(NalDepacketizer(H264), packets)
    assert [unit.timestamp for unit in units] == [0, 3000, 6000]
    assert {unit.data for unit in units} == {join_annex_b([SLICE, LATER_SLICE])}


def test_a_sender_that_marks_each_slice_costs_no_picture():
    def sent(number):
        return [
            received(unit, 2 * number + at, timestamp=3000 * number, received_ns=number)
            for at, unit in enumerate((SLICE, LATER_SLICE))
        ]

    depacketizer = NalDepacketizer(H264)
    units = through(depacketizer, [packet for number in range(4) for packet in sent(number)])
    assert [split_annex_b(unit.data) for unit in units] == [[SLICE, LATER_SLICE]] * 4
    assert not any(unit.damaged for unit in units)
    # Even if markers were believed at first: then the first two slices are two units.
    units = through(NalDepacketizer(H264, marked=True), sent(0) + sent(1) + sent(2))
    assert [split_annex_b(unit.data) for unit in units[-2:]] == [[SLICE, LATER_SLICE]] * 2
    assert not units[-1].damaged


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
    unit = depacketizer.next_event()
    assert unit is not None and not unit.damaged and depacketizer.poll_timeout() is None
    # From then on the marker ends pictures, if it had one.
    depacketizer.handle_packet(received(SLICE, 1, timestamp=3000))
    assert (depacketizer.next_event() is not None) is markers_end


def test_a_loss_within_a_picture_damages_it_and_one_at_its_end_does_too():
    packets = [
        received(SLICE, 0, marker=False),
        received(LATER_SLICE, 2, lost_before=1),
        received(SLICE, 3, timestamp=3000, marker=False),
        # The end of the second and the beginning of the third are lost.
        received(LATER_SLICE, 6, timestamp=6000, lost_before=2),
        received(SLICE, 7, timestamp=9000),
    ]
    units = through(NalDepacketizer(H264), packets)
    assert [(unit.timestamp, unit.damaged, unit.lost_before) for unit in units] == [
        (0, True, 0),
        (3000, True, 0),
        (6000, True, 2),
        (9000, False, 0),
    ]


def test_losses_before_packets_without_content_count_for_the_next_unit():
    packets = [
        received(SLICE, 0),
        received(b"", 2, timestamp=3000, lost_before=1),
        received(b"\0", 4, timestamp=3000, lost_before=1),
        received(SLICE, 6, timestamp=3000, lost_before=1),
        received(SLICE, 7, timestamp=6000),
    ]
    units = through(NalDepacketizer(H264), packets)
    assert [unit.lost_before for unit in units] == [0, 3, 0]


@pytest.mark.parametrize("garbage", [b"\x7f", b"\x7c\x01\x88"])
def test_garbage_within_a_picture_damages_it(garbage):
    depacketizer = NalDepacketizer(H264)
    packets = [
        received(SLICE, 0, marker=False),
        # No payload, or a later part of nothing.
        received(garbage, 1, marker=False),
        received(LATER_SLICE, 2),
        received(SLICE, 3, timestamp=3000),
    ]
    units = through(depacketizer, packets)
    assert [unit.damaged for unit in units] == [True, False]
    assert depacketizer.garbage == (garbage == b"\x7f")


def test_a_unit_that_is_dropped_is_a_loss_before_the_next():
    small = NalDepacketizer(H264, max_unit_octets=10)
    units = through(small, pictures(SLICE, SLICE + bytes(9) + b"\1", SLICE, SLICE))
    assert [(unit.timestamp, unit.lost_before) for unit in units] == [(0, 0), (6000, 1), (9000, 0)]
    assert (small.garbage, small.units) == (1, 3)


@pytest.mark.parametrize("marked", [True, False])
def test_leading_and_key_pictures_of_hevc_are_told(marked):
    kinds = (21, 8, 9, 1, 19, 20, 16, 23)  # ITU-T H.265 table 7-1: CRA, RASL, TRAIL, IDR, BLA, IRAP
    payloads = [bytes((kind << 1, 1, 0x88)) for kind in kinds]
    units = through(NalDepacketizer(H265, marked=marked), pictures(*payloads))
    assert [unit.keyframe for unit in units] == [
        *(True, False, False, False, True, True, True, True)
    ]
    assert [unit.leading for unit in units] == [False, True, True, *[False] * 5]
    assert {unit.codec for unit in units} == {"h265"}
    # The first bit behind two octets of header tells a picture's first slice.
    packets = [
        received(bytes((2, 1, one)), number, marker=False)
        for number, one in enumerate((0x80, 0x7F, 0xFF, 0x01))
    ]
    units = through(NalDepacketizer(H265), packets)
    assert [len(split_annex_b(one.data)) for one in units] == [2, 2]


@pytest.mark.parametrize("kind", [32, 33, 34, 35, 39, 41, 44])
def test_what_goes_ahead_of_a_picture_of_hevc_begins_it(kind):
    """ITU-T H.265 clause 7.4.2.4.4."""
    first, ahead = bytes.fromhex("020188"), bytes((kind << 1, 1, 9))
    packets = [received(unit, n, marker=False) for n, unit in enumerate((first, ahead, first))]
    units = through(NalDepacketizer(H265), packets)
    assert [split_annex_b(unit.data) for unit in units] == [[first], [ahead, first]]

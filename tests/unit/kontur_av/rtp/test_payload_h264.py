"""H.264 in RTP: what the headers say, and which access units come out."""

import pytest
from rtp_packets import received

from kontur_av.rtp.annex_b import join_annex_b, split_annex_b
from kontur_av.rtp.nal_payload import NalDepacketizer
from kontur_av.rtp.payload_h264 import H264, packetize, parse_payload

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
    (payload,) = packetize([b"\x06\x05", b"\x41\x88", b"\x21\x88"])
    assert payload[0] == 0x40 | 24
    (payload,) = packetize([b"\x86\x05", b"\x67\x42"])
    assert payload[0] == 0x80 | 0x60 | 24


@pytest.mark.parametrize(
    ("octets", "parts"), [(1201, [600, 600]), (2397, [1198] * 2), (2399, [800, 799, 799])]
)
def test_a_large_unit_is_cut_into_equal_parts(octets, parts):
    unit = b"\x41" + bytes(1 + n % 255 for n in range(octets - 1))
    payloads = packetize([unit], 1200)
    assert sorted((len(payload) - 2 for payload in payloads), reverse=True) == parts
    found = [parse_payload(payload) for payload in payloads]
    assert b"".join(part.nal_units[0] for part in found) == unit
    assert [part.starts for part in found] == [True] + [False] * (len(parts) - 1)
    assert [part.ends for part in found] == [False] * (len(parts) - 1) + [True]


def test_units_share_a_payload_as_long_as_they_fit():
    units = [b"\x41" + bytes([n] * 3) for n in range(1, 4)]
    # One octet for the aggregate, two for each length.
    assert [len(payload) for payload in packetize(units, 19)] == [19]
    assert [len(payload) for payload in packetize(units, 18)] == [13, 4]
    assert [len(payload) for payload in packetize([bytes([0x41] * 8)], 8)] == [8]


@pytest.mark.parametrize("most", [0, 7])
def test_payloads_too_small_for_headers_are_refused(most):
    with pytest.raises(ValueError, match="at least 8"):
        packetize([SLICE], most)


@pytest.mark.parametrize("unit", [b"", b"\x60", b"\x78\x01", b"\x7c\x01"])
def test_a_unit_that_rtp_cannot_carry_is_refused(unit):
    with pytest.raises(ValueError, match="cannot carry"):
        packetize([unit])


def test_sets_of_the_sdp_go_before_the_first_picture_and_every_later_idr():
    depacketizer = NalDepacketizer(H264, [SPS, PPS])
    own = packetize([SPS, PPS, IDR])[0]
    units = through(depacketizer, pictures(SLICE, SLICE, IDR, SLICE, own))
    assert [split_annex_b(unit.data) for unit in units] == [
        [SPS, PPS, SLICE],
        [SLICE],
        [SPS, PPS, IDR],
        [SLICE],
        [SPS, PPS, IDR],
    ]
    assert [unit.keyframe for unit in units] == [False, False, True, False, True]
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
    whole, cut = packetize([SLICE]), packetize([b"\x41\x88" + bytes([7]) * 30], 20)
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
    parts = packetize([b"\x41\x88" + bytes([7]) * 60], 30)
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
    parts = packetize([b"\x41\x88" + bytes([7]) * 60], 30)
    packets = [
        received(packetize([SLICE])[0], 0, timestamp=0),
        # The first part is lost. The others belong to no NAL unit.
        *(
            received(part, 2 + n, timestamp=1, marker=n == len(parts) - 2, lost_before=n == 0)
            for n, part in enumerate(parts[1:])
        ),
        received(packetize([SLICE])[0], 9, timestamp=2),
    ]
    units = through(depacketizer, packets)
    assert [(unit.timestamp, unit.lost_before) for unit in units] == [(0, 0), (2, 1)]
    # Its successor has no loss before it.
    (after,) = through(depacketizer, [received(packetize([SLICE])[0], 10, timestamp=3)])
    assert after.lost_before == 0


def test_a_picture_of_the_old_source_is_damaged_by_a_restart():
    parts = packetize([SLICE, b"\x41\x22" + bytes([7]) * 30], 20)
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
    parts = packetize([whole], 20)
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

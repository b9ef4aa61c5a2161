"""H.264 and HEVC in RTP payloads: octets of RFC 6184 and RFC 7798, written and read."""

import pytest

from kontur_av.errors import ProtocolError
from kontur_av.rtp.annex_b import join_annex_b, split_annex_b
from kontur_av.rtp.nal_formats import H264, H265, parameter_sets_of

SPS, PPS = bytes.fromhex("6742c01e"), bytes.fromhex("68ce3c80")
IDR = bytes.fromhex("6588840102030405060708090a0b")
VPS_265, SPS_265 = bytes.fromhex("40010c01ffff"), bytes.fromhex("420101016090")
PPS_265, IDR_265 = bytes.fromhex("4401c172b0"), bytes.fromhex("2601af0102030405060708090a")


def fromhex(*texts):
    return [bytes.fromhex(text) for text in texts]


@pytest.mark.parametrize(
    ("form", "units", "payload"),
    [
        # STAP-A of RFC 6184 section 5.7.1: F=0, the largest NRI 3, type 24; then a length of 16
        # bits before each.
        (H264, [SPS, PPS, IDR], "78 0004 6742c01e 0004 68ce3c80 000e" + IDR.hex()),
        (H264, fromhex("0605", "4188", "2188"), "58 0002 0605 0002 4188 0002 2188"),
        (H264, fromhex("8605", "6742"), "f8 0002 8605 0002 6742"),
        # RFC 7798 section 4.4.2: F=0, type 48, layer 0, TID 1.
        (
            *(H265, [VPS_265, SPS_265, PPS_265]),
            "6001 0006 40010c01ffff 0006 420101016090 0005 4401c172b0",
        ),
        # Layer 33 with TID 3, and layer 2 with TID 2 and the forbidden bit.
        (H265, fromhex("030b11", "821222"), "e012 0003 030b11 0003 821222"),
    ],
)
def test_small_nal_units_share_a_payload_that_has_the_most_important_header(form, units, payload):
    assert form.packetize(units) == fromhex(payload)
    assert form.parse_payload(bytes.fromhex(payload)).nal_units == tuple(units)


@pytest.mark.parametrize(
    ("form", "unit", "payloads"),
    [
        # FU indicator: NRI=3, type 28; FU header: start, -, end | type 5; NAL header is left out
        (H264, IDR, ["7c 85 88840102", "7c 05 03040506", "7c 45 0708090a0b"]),
        # Section 4.4.3: the header with type 49, then S, E and the original type 19
        (H265, IDR_265, ["6201 93 af0102", "6201 13 03040506", "6201 53 0708090a"]),
    ],
)
def test_a_large_nal_unit_is_cut_into_fragments(form, unit, payloads):
    assert form.packetize([unit], 8) == fromhex(*payloads)
    found = [form.parse_payload(payload) for payload in fromhex(*payloads)]
    # The first one has the NAL header again.
    assert b"".join(part.nal_units[0] for part in found) == unit
    assert [(part.is_part, part.starts, part.ends) for part in found] == [
        *((True, True, False), (True, False, False), (True, False, True))
    ]


@pytest.mark.parametrize(
    ("octets", "parts"), [(1201, [600, 600]), (2397, [1198] * 2), (2399, [800, 799, 799])]
)
def test_the_fragments_of_a_unit_are_equally_long(octets, parts):
    payloads = H264.packetize([b"\x41" + bytes(octets - 1)], 1200)
    assert sorted((len(payload) - 2 for payload in payloads), reverse=True) == parts


def test_units_share_a_payload_as_long_as_they_fit():
    units = [b"\x41" + bytes([n] * 3) for n in range(1, 4)]
    # One octet for the aggregate, two for each length.
    for most, octets in ((19, [19]), (18, [13, 4])):
        assert [len(payload) for payload in H264.packetize(units, most)] == octets
    assert [len(payload) for payload in H264.packetize([bytes([0x41] * 8)], 8)] == [8]
    for most in (0, 7):
        with pytest.raises(ValueError, match="at least 8"):
            H264.packetize(units, most)
    for unit in fromhex("", "60", "7801", "7c01"):
        with pytest.raises(ValueError, match="cannot carry"):
            H264.packetize([unit])


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
    assert found.nal_units == tuple(fromhex(*units))
    assert (found.is_part, found.starts, found.ends) == (False, True, True)


@pytest.mark.parametrize(
    ("form", "payload", "reason"),
    [
        (H264, "", "an empty payload"),
        (H264, "0001", "without a NAL unit"),
        (H264, "79 00 0002 4188", "of type 25"),
        (H264, "7d 81 88", "of type 29"),
        (H264, "78", "without content"),
        (H264, "78 0000", "without content"),
        (H264, "78 0003 4188", "cut or nested"),
        (H264, "78 0002 7888", "cut or nested"),
        (H264, "7c", "without its header"),
        (H264, "7c 98", "with the header 0x98"),
        *((H265, octets, ".") for octets in ("", "62", "6201", "6401ff", "6001000526", "7e01aa")),
        (H265, "2600", "."),
    ],
)
def test_payloads_that_are_none_are_refused(form, payload, reason):
    with pytest.raises(ProtocolError, match=reason):
        form.parse_payload(bytes.fromhex(payload))


def test_parameter_sets_are_those_of_a_unit_with_an_sps():
    assert split_annex_b(H264.parameter_sets(join_annex_b([SPS, PPS, IDR]))) == [SPS, PPS]
    assert H264.parameter_sets(join_annex_b([PPS, IDR])) == b""
    assert parameter_sets_of(join_annex_b([PPS, SPS]), "h264") == join_annex_b([PPS, SPS])
    unit = join_annex_b([VPS_265, SPS_265, IDR_265])
    assert parameter_sets_of(unit, "h265") == join_annex_b([VPS_265, SPS_265])
    assert parameter_sets_of(unit, "h264") == b""

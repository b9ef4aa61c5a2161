"""RTCP octets by hand from RFC 3550, 4585 and 5104, and aiortc as the other reader and writer."""

import pytest
from aiortc import rtp as peer
from hypothesis import given
from hypothesis import strategies as st

from kontur_av.errors import ProtocolError
from kontur_av.rtp import rtcp
from kontur_av.rtp.rtcp import parse_rtcp

BLOCK = rtcp.RtcpReceiverInfo(7, 64, -2, 0x1_0002, 3, 4, 5)
BLOCK_HEX = "00000007 40fffffe 00010002 00000003 00000004 00000005"
INFO = rtcp.RtcpSenderInfo(0x0102030405060708, 9, 10, 11)
INFO_HEX = "01020304 05060708 00000009 0000000a 0000000b"
NAMES = [rtcp.RtcpSourceInfo(1, [(1, b"ab")]), rtcp.RtcpSourceInfo(2, [(1, b""), (6, b"x")])]
GOLDEN = [
    (rtcp.RtcpSrPacket(1, INFO, [BLOCK]), f"81c8000c 00000001 {INFO_HEX} {BLOCK_HEX}"),
    (rtcp.RtcpRrPacket(1, [BLOCK, BLOCK]), f"82c9000d 00000001 {BLOCK_HEX} {BLOCK_HEX}"),
    # Four octets of null follow items that end at a word.
    (rtcp.RtcpSdesPacket(NAMES), "82ca0006 00000001 01026162 00000000 00000002 01000601 78000000"),
    (rtcp.RtcpByePacket([1, 2]), "82cb0002 00000001 00000002"),
    (rtcp.RtcpPsfbPacket(1, 1, 7), "81ce0002 00000001 00000007"),
    (rtcp.RtcpPsfbPacket(4, 1, 0, bytes(8)), "84ce0004 00000001 00000000 00000000 00000000"),
    # The bit mask reaches 16 packets, also beyond the wrap-around.
    (
        rtcp.RtcpRtpfbPacket(1, 1, 7, [65535, 0, 15, 16]),
        "81cd0004 00000001 00000007 ffff8001 00100000",
    ),
]


@pytest.mark.parametrize(("packet", "octets"), GOLDEN, ids=lambda one: type(one).__name__)
def test_packets_have_the_octets_of_the_standards(packet, octets):
    assert bytes(packet) == bytes.fromhex(octets)
    assert parse_rtcp(bytes(packet)) == [packet]
    if not isinstance(packet, rtcp.RtcpSdesPacket | rtcp.RtcpRtpfbPacket):
        # aiortc reads one chunk of names only, and numbers of lost packets beyond 16 bits.
        assert bytes(peer.RtcpPacket.parse(bytes(packet))[0]) == bytes(packet)


def test_a_compound_packet_is_read_as_far_as_it_is_well_formed():
    report, goodbye = bytes.fromhex("80c90001 00000001"), bytes.fromhex("81cb0001 00000002")
    # A length beyond the end means the rest, and what follows a good packet may be malformed.
    for behind in (goodbye, b"\x81\xcb\0\x09\0\0\0\2", goodbye + b"\x81", goodbye + bytes(8)):
        kinds = [type(one).__name__ for one in parse_rtcp(report + behind)]
        assert kinds == ["RtcpRrPacket", "RtcpByePacket"]
    for octets in (b"", b"\x80", bytes(12)):
        with pytest.raises(ProtocolError):
            parse_rtcp(octets)


def test_padding_extensions_of_profiles_and_unknown_types_are_passed_over():
    extended = bytes.fromhex(f"81c90008 00000001 {BLOCK_HEX} 41424344")
    padded = bytes.fromhex("a1cb0002 00000002 00000004")
    unknown = bytes.fromhex("80d00001 00000001")
    assert parse_rtcp(unknown) == []
    assert parse_rtcp(extended + unknown + padded) == [
        rtcp.RtcpRrPacket(1, [BLOCK]),
        rtcp.RtcpByePacket([2]),
    ]
    # An item that is longer than its packet ends the reading.
    assert len(parse_rtcp(padded + bytes.fromhex("81ca0002 00000001 01096162"))) == 1


@given(st.integers(0, 2**40), st.lists(st.integers(0, 2**32 - 1), max_size=31))
def test_a_rate_is_read_as_aiortc_wrote_it_and_the_other_way(rate_bps, ssrcs):
    fci = rtcp.pack_remb_fci(rate_bps, ssrcs)
    assert fci == peer.pack_remb_fci(rate_bps, ssrcs)
    assert rtcp.unpack_remb_fci(fci) == peer.unpack_remb_fci(fci)
    for cut in (fci[:-1], b"ABCD" + fci[4:]):
        with pytest.raises(ProtocolError):
            rtcp.unpack_remb_fci(cut)


@given(st.lists(st.integers(0, 65535), unique=True, max_size=40).map(sorted))
def test_all_lost_packets_are_named(lost):
    packet = rtcp.RtcpRtpfbPacket(rtcp.RTCP_RTPFB_NACK, 1, 7, lost)
    assert parse_rtcp(bytes(packet))[0].lost == lost
    (read,) = peer.RtcpPacket.parse(bytes(packet))
    assert read.lost == lost

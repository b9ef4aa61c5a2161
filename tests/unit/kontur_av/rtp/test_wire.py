"""RTP octets derived by hand from RFC 3550."""

import pytest

from kontur_av.errors import ProtocolError
from kontur_av.rtp.wire import TimestampUnwrapper, parse_rtp

PLAIN = bytes.fromhex("80e00001 00000002 00000003")


def test_padding_extension_and_csrc_are_no_payload():
    packet = parse_rtp(
        bytes.fromhex(
            "b1 60 0001 00000002 00000003"  # V=2, P, X, one CSRC
            "00000004"  # CSRC
            "bede0001 10ff0000"  # RFC 8285 extension of one word
            "4142 000003"  # payload, 3 octets of padding
        )
    )
    assert (packet.payload, packet.sequence_number, packet.marker) == (b"AB", 1, 0)
    # Padding larger than the packet is none, and a packet may be a header alone.
    padded = bytes([PLAIN[0] | 0x20]) + PLAIN[1:]
    assert parse_rtp(padded + b"media\0\0\3").payload == b"media"
    assert parse_rtp(padded + b"media\xff").payload == b"media\xff"
    assert (parse_rtp(PLAIN).payload, parse_rtp(PLAIN).marker) == (b"", 1)


def test_packets_that_are_no_rtp_are_refused():
    packet = PLAIN + b"\x41"
    for octets in (packet[:11], b"\x40" + packet[1:], b"\xc0" + packet[1:], b"\x81" + packet[1:]):
        with pytest.raises(ProtocolError, match="not an RTP packet"):
            parse_rtp(octets)


def test_timestamps_are_counted_on_across_their_end():
    unwrapper = TimestampUnwrapper()
    ticks = [0, 5, 3, 2**31, 2**31 + 100, 2**32 + 5, 2**32]
    assert [unwrapper.unwrap((2**32 - 10 + tick) % 2**32) for tick in ticks] == ticks

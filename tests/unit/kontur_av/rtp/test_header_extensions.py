"""Header extensions: octets of RFC 8285, and garbage."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from kontur_av.errors import ProtocolError
from kontur_av.rtp.header_extensions import (
    capture_time_element,
    elements_of,
    extended,
    header_octets,
    picture_element,
    playout_delay_element,
    read_capture_time,
    read_picture,
    send_time_element,
)
from kontur_av.rtp.wire import pack_rtp, parse_rtp

PLAIN = pack_rtp(b"media", payload_type=96, marker=True, sequence=7, timestamp=8, ssrc=9)


def with_x(extension: str) -> bytes:
    """Return the header of a packet with these octets behind it."""
    return bytes([0x90]) + PLAIN[1:12] + bytes.fromhex(extension)


def test_a_packet_has_the_octets_of_the_rfc():
    packet = extended(PLAIN, [(1, b"0"), (3, playout_delay_element(least_ms=0, most_ms=0))])
    # X is set; profile BEDE, two words: id 1 of 1 octet, id 3 of 3 octets, padding (section 4.2).
    assert packet == with_x("bede0002 1030 32000000 0000") + b"media"
    assert parse_rtp(packet).payload == b"media"
    assert extended(PLAIN, ()) == PLAIN


def test_a_picture_has_its_number_and_its_size():
    assert picture_element(0x1_00_0005, 1280, 722) == bytes.fromhex("000005280169")
    assert read_picture(bytes.fromhex("00ffff800008")) == (0xFFFF, 4096, 16)
    for wrong in ("", "000005 28", "000005 280 169 00", "000005 801 169", "000005 280 007"):
        assert read_picture(bytes.fromhex(wrong.replace(" ", ""))) is None


def test_elements_have_their_units():
    # Ten milliseconds; 18 bits of fraction, which wrap after 64 s.
    assert playout_delay_element(least_ms=100, most_ms=40_950) == bytes.fromhex("00afff")
    for least_ms, most_ms in ((0, 40_960), (20, 10)):
        with pytest.raises(ValueError, match="playout delay"):
            playout_delay_element(least_ms=least_ms, most_ms=most_ms)
    assert send_time_element(1_500_000_000) == bytes.fromhex("060000")
    assert send_time_element(64_000_000_000) == bytes(3)
    # An NTP timestamp, 1.5 s after 1970, with or without an offset.
    value, ntp = capture_time_element(1_500_000_000), 0x83AA7E81_80000000
    assert value == ntp.to_bytes(8, "big")
    for more, read in ((0, ntp), (8, ntp), (1, None), (7, None)):
        assert read_capture_time(value + bytes(more)) == read


@given(
    st.dictionaries(st.integers(1, 14), st.binary(min_size=1, max_size=16), max_size=14),
    st.binary(max_size=80),
)
def test_elements_come_back_and_garbage_raises_only_protocol_errors(elements, garbage):
    packet = extended(PLAIN, list(elements.items()))
    assert elements_of(packet) == elements
    assert parse_rtp(packet).payload == b"media"
    try:
        elements_of(bytes([0x90]) + garbage)
    except ProtocolError:
        return


@pytest.mark.parametrize(
    ("packet", "element", "reason"),
    [
        (extended(PLAIN, [(1, b"0")]), (1, b"0"), "extension"),
        (bytes([PLAIN[0] | 1]) + PLAIN[1:], (1, b"0"), "contributing"),
        (PLAIN, (15, b"0"), "id 15"),
        (PLAIN, (0, b"0"), "an element of id"),
        (PLAIN, (1, b""), "an element of id"),
        (PLAIN, (1, bytes(17)), "an element of id"),
    ],
)
def test_what_no_packet_can_carry_is_refused(packet, element, reason):
    with pytest.raises(ValueError, match=reason):
        extended(packet, [element])


def test_elements_are_read_up_to_id_15_and_none_is_longer_than_the_extension():
    # RFC 8285 section 4.2: what follows id 15 is not read.
    assert elements_of(with_x("bede0002 1030 f031 2032 0000")) == {1: b"0"}
    assert elements_of(with_x("bede0001 e2 303030")) == {14: b"000"}
    with pytest.raises(ProtocolError, match="an element"):
        elements_of(with_x("bede0001 13 303030"))


def test_contributing_sources_go_before_the_elements():
    extension = bytes.fromhex("bede0002 00 00 1030 2131 32 00")
    packet = bytes([0x92]) + PLAIN[1:12] + bytes(range(8)) + extension + b"media"
    assert elements_of(packet) == {1: b"0", 2: b"12"}
    assert header_octets(packet) == 12 + 8 + 12
    assert parse_rtp(packet).payload == b"media"
    assert (header_octets(PLAIN), elements_of(PLAIN), elements_of(packet[:11])) == (12, {}, {})
    # Other profiles are skipped whole.
    other = packet.replace(b"\xbe\xde", b"\x10\x00")
    assert (elements_of(other), parse_rtp(other).payload) == ({}, b"media")
    for octets in (12, 20, 22, 23, 24, 31):
        with pytest.raises(ProtocolError, match="cut off"):
            elements_of(packet[:octets])

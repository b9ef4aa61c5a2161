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
    playout_delay_element,
    read_capture_time,
    send_time_element,
)
from kontur_av.rtp.wire import pack_rtp, parse_rtp

PLAIN = pack_rtp(b"media", payload_type=96, marker=True, sequence=7, timestamp=8, ssrc=9)


def test_a_packet_has_the_octets_of_the_rfc():
    packet = extended(PLAIN, [(1, b"0"), (3, playout_delay_element(least_ms=0, most_ms=0))])
    # X is set; profile BEDE, two words: id 1 of 1 octet, id 3 of 3 octets, padding (section 4.2).
    assert (
        packet
        == bytes([0x90]) + PLAIN[1:12] + bytes.fromhex("bede0002 1030 32000000 0000") + b"media"
    )
    assert parse_rtp(packet).payload == b"media"


def test_playout_delay_counts_in_ten_milliseconds():
    assert playout_delay_element(least_ms=100, most_ms=40_950) == bytes.fromhex("00afff")
    for least_ms, most_ms in ((0, 40_960), (20, 10)):
        with pytest.raises(ValueError, match="playout delay"):
            playout_delay_element(least_ms=least_ms, most_ms=most_ms)


def test_the_send_time_has_18_bits_of_fraction_and_wraps_after_64_s():
    assert send_time_element(1_500_000_000) == bytes.fromhex("060000")
    assert send_time_element(64_000_000_000) == bytes(3)


@given(
    st.dictionaries(st.integers(1, 14), st.binary(min_size=1, max_size=16), max_size=14),
)
def test_elements_come_back(elements):
    packet = extended(PLAIN, list(elements.items()))
    assert elements_of(packet) == elements
    assert parse_rtp(packet).payload == b"media"


@given(st.binary(max_size=80))
def test_garbage_raises_only_protocol_errors(octets):
    try:
        elements_of(bytes([0x90]) + octets)
    except ProtocolError:
        return


def test_a_packet_with_an_extension_is_refused():
    with pytest.raises(ValueError, match="extension"):
        extended(extended(PLAIN, [(1, b"0")]), [(1, b"0")])
    with pytest.raises(ValueError, match="contributing"):
        extended(bytes([PLAIN[0] | 1]) + PLAIN[1:], [(1, b"0")])


def test_id_15_is_not_given_and_ends_the_elements():
    with pytest.raises(ValueError, match="id 15"):
        extended(PLAIN, [(15, b"0")])
    # RFC 8285 section 4.2: what follows it is not read.
    packet = bytes([0x90]) + PLAIN[1:12] + bytes.fromhex("bede0002 1030 f031 2032 0000")
    assert elements_of(packet) == {1: b"0"}


def test_padding_is_no_payload_and_a_packet_may_be_a_header_alone():
    padded = bytes([PLAIN[0] | 0x20]) + PLAIN[1:]
    assert parse_rtp(padded + b"\0\0\3").payload == b"media"
    assert parse_rtp(padded + b"\xff").payload == b"media\xff"
    assert parse_rtp(PLAIN[:12]).payload == b""


def test_contributing_sources_go_before_the_elements():
    sources = bytes(range(8))
    extension = bytes.fromhex("bede0002 00 00 1030 2131 32 00")
    packet = bytes([0x92]) + PLAIN[1:12] + sources + extension + b"media"
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
    # An element that is longer than the extension.
    with pytest.raises(ProtocolError, match="an element"):
        elements_of(bytes([0x90]) + PLAIN[1:12] + bytes.fromhex("bede0001 13 303030"))
    last = bytes([0x90]) + PLAIN[1:12] + bytes.fromhex("bede0001 e2 303030")
    assert elements_of(last) == {14: b"000"}


def test_a_capture_time_is_an_ntp_timestamp_with_or_without_an_offset():
    # 1.5 s after 1970.
    value = capture_time_element(1_500_000_000)
    assert value == bytes.fromhex("83aa7e81 80000000")
    ntp = 0x83AA7E81_80000000
    assert [read_capture_time(value + bytes(more)) for more in (0, 8, 1, 7)] == [
        *(ntp, ntp, None, None)
    ]
    assert extended(PLAIN, ()) == PLAIN
    for number, octets in ((0, b"0"), (1, b""), (1, bytes(17))):
        with pytest.raises(ValueError, match="an element of id"):
            extended(PLAIN, [(number, octets)])

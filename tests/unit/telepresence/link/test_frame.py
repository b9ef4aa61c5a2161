"""Transfer frames, bit by bit with the standard's arithmetic (CCSDS 732.0-B-5, 4.1)."""

from binascii import crc_hqx
from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from telepresence.link.frame import FrameCodec, Pointers, length_octets
from telepresence.link.profile import DOWNLINK, UPLINK, LinkProfile


def crc16_by_division(octets: bytes) -> int:
    """Return the remainder of division by x^16 + x^12 + x^5 + 1 from all ones (4.1.6.2)."""
    register = 0xFFFF
    for octet in octets:
        for bit in range(7, -1, -1):
            quotient = register >> 15 ^ octet >> bit & 1
            register = register << 1 & 0xFFFF ^ (0x1021 if quotient else 0)
    return register


def bits(value: int, width: int) -> str:
    assert 0 <= value < 1 << width
    return f"{value:0{width}b}"


def frame_by_bits(profile, count, sample, pointer, zone):
    """Return the fields of CCSDS 732.0-B-5 4.1.2, one after the other, as strings of bits."""
    in_vcid = profile.pointer_in_vcid
    header = (
        "01"  # transfer frame version number
        + bits(profile.scid, 8)  # the eight lowest bits of the SCID
        + bits(profile.vcid + (pointer if in_vcid else 0), 6)
        + bits(count % 2**24, 24)
        + "0"  # replay flag
        + ("0" if sample is None else "1")  # VC frame count usage flag
        + "00"  # the two highest bits of the SCID
        + "0000"  # VC frame count cycle
    )
    mpdu = "" if in_vcid else "00000" + bits(pointer, 11)
    octets = b"".join(
        int(piece, 2).to_bytes(len(piece) // 8, "big") if isinstance(piece, str) else piece
        for piece in (header, sample or b"", *([mpdu] if mpdu else []), zone)
    )
    return octets + crc16_by_division(octets).to_bytes(2, "big")


#: Profiles with the largest zones that leave room for all codes: 27 octets, and 2043.
WIDEST = [
    LinkProfile(name="short", frame_octets=35, scid=0, vcid=31, pointer_in_vcid=True),
    LinkProfile(name="long", frame_octets=2053, scid=255, vcid=0),
]


def test_fecf_is_the_standards_crc():
    assert crc16_by_division(b"123456789") == crc_hqx(b"123456789", 0xFFFF) == 0x29B1


@pytest.mark.parametrize("profile", [UPLINK, DOWNLINK, *WIDEST], ids=lambda profile: profile.name)
@given(data=st.data())
def test_codec_follows_the_standard(profile, data):
    count = data.draw(st.integers(0, 2**25))
    insert = st.binary(min_size=profile.insert_octets, max_size=profile.insert_octets)
    sample = data.draw(st.none() | insert)
    size = profile.largest_zone_octets if sample is None else profile.packet_zone_octets
    zone = data.draw(st.binary(max_size=12)).ljust(size, b"\0")
    codes = Pointers(profile)
    named = (codes.no_start, codes.idle, codes.preempt, codes.supervision)
    pointer = data.draw(st.integers(0, size) | st.sampled_from(named))
    assert set(named).isdisjoint(range(size + 1))
    codec = FrameCodec(profile)
    frame = codec.pack(count, sample, pointer, zone)
    assert frame == frame_by_bits(profile, count, sample, pointer, zone)
    assert len(frame) == profile.frame_octets
    assert codec.parse(frame) == (count % 2**24, sample, pointer, zone)
    idle = codec.pack_idle(count, sample)
    assert idle == codec.pack(count, sample, codes.idle, bytes(size))
    assert codec.parse(idle) == (count % 2**24, sample, codes.idle, bytes(size))
    # Up to three flipped bits are always detected, also in an idle frame.
    for flipped in (frame, idle):
        wrong = int.from_bytes(flipped, "big")
        for bit in data.draw(st.sets(st.integers(0, 8 * len(frame) - 1), min_size=1, max_size=3)):
            wrong ^= 1 << bit
        assert codec.parse(wrong.to_bytes(len(frame), "big")) == "fecf"


@pytest.mark.parametrize("profile", [UPLINK, DOWNLINK])
@pytest.mark.parametrize("sample", [None, bytes(range(12))])
def test_a_frame_of_another_channel_or_kind_is_told_by_its_field(profile, sample):
    codec = FrameCodec(profile)
    for frame in (codec.pack_idle(7, sample), codec.pack(7, sample, 0, bytes(500))):
        body = bytearray(frame[:-2])

        def parsed(body=body, **changes):
            changed = bytearray(body)
            for at, mask in changes.items():
                changed[int(at[1:])] ^= mask
            return codec.parse(bytes(changed) + crc_hqx(changed, 0xFFFF).to_bytes(2, "big"))

        assert not isinstance(parsed(), str)
        assert parsed(_0=0x80) == parsed(_0=0x40) == "version"
        assert parsed(_0=0x20) == parsed(_1=0x40) == "scid"
        assert parsed(_1=0x20) == "vcid"
        for bit in (0x80, 0x20, 0x10, 0x08, 0x01):
            assert parsed(_5=bit) == "signaling"
        for at in (0, 6, len(frame) // 2, len(frame) - 1):
            assert codec.parse(frame[:at] + bytes([frame[at] ^ 4]) + frame[at + 1 :]) == "fecf"
        assert codec.parse(frame[:-1]) == codec.parse(frame + b"\0") == "length"
        if profile is DOWNLINK:
            # An M_PDU header has five spare bits.
            at = f"_{6 + len(sample or b'')}"
            assert parsed(**{at: 0x08}) == "mpdu"


def test_the_codes_of_a_pointer_are_its_largest_values():
    for profile, ones in ((UPLINK, 31), (DOWNLINK, 2047)):
        codes = Pointers(profile)
        assert (codes.no_start, codes.idle, codes.preempt, codes.supervision) == (
            *(ones, ones - 1, ones - 2, ones - 3),
        )
    # A closed piece of up to 127 octets has a length of one octet, beside its tag.
    edge = replace(DOWNLINK, frame_octets=6 + 2 + 129 + 2)
    assert edge.largest_zone_octets == 129
    longer = replace(edge, frame_octets=edge.frame_octets + 1)
    assert [length_octets(one) for one in (UPLINK, edge, longer, DOWNLINK)] == [1, 1, 2, 2]

"""Transfer frames octet by octet, both ways."""

import struct
from binascii import crc_hqx

from telepresence.link.flows import Level, packet_flow, video_flow, voice_flow
from telepresence.link.profile import DOWNLINK, UPLINK
from telepresence.link.receiver import HapticReceived, LinkReceiver, PacketReceived
from telepresence.link.sender import LinkSender

FLOWS = [
    video_flow("video"),
    voice_flow("voice"),
    packet_flow("maintenance", Level.MAINTENANCE),
    packet_flow("tmtc", Level.TMTC),
]
SAMPLE = bytes.fromhex("0001020304050607 08090a0b")


def crc16_by_division(octets: bytes) -> int:
    """x^16 + x^12 + x^5 + 1 divided out bit by bit from all ones (CCSDS 732.0-B 4.1.6.2)."""
    register = 0xFFFF
    for octet in octets:
        for bit in range(7, -1, -1):
            quotient = register >> 15 ^ octet >> bit & 1
            register = register << 1 & 0xFFFF ^ (0x1021 if quotient else 0)
    return register


def test_fecf_is_the_books_crc():
    assert crc16_by_division(b"123456789") == 0x29B1
    assert crc_hqx(b"123456789", 0xFFFF) == 0x29B1


def test_uplink_frame_by_hand():
    sender = LinkSender(UPLINK, FLOWS, first_count=5)
    sender.handle_haptic(SAMPLE, 0)
    sender.handle_packet("tmtc", b"abc", 0)
    frame = sender.poll_transmit(0)
    # '01' version, 0x4B = '01001011' SCID, '000001' VCID: 0101 0010 1100 0001.
    header = bytes.fromhex("52c1 000005 20")  # sample flag; first header pointer 0
    # '1' closed, '001' raw, '0011' flow 3; 3 octets; 7 octets of fill.
    zone = bytes.fromhex("93 03 616263 00 000000000000")
    body = header + SAMPLE + zone
    assert frame == body + struct.pack(">H", crc16_by_division(body))
    assert frame.hex() == ("52c100000520000102030405060708090a0b9303616263000000000000006a25")


def test_uplink_packet_over_three_frames_and_a_telecommand_between():
    sender = LinkSender(UPLINK, FLOWS, first_count=0xFFFFFF)
    sender.handle_packet("maintenance", bytes(range(0x30, 0x48)), 0)  # 24 octets
    first = sender.poll_transmit(0)
    sender.handle_packet("tmtc", b"TC", 0)
    second = sender.poll_transmit(0)
    third = sender.poll_transmit(0)
    fourth = sender.poll_transmit(0)
    # No sample: flag 0, insert zone zero. Open raw tag of flow 2 and the first 11 octets.
    assert first[2:18].hex() == "ffffff00" + "00" * 12
    assert first[18:30].hex() == "12" + bytes(range(0x30, 0x3B)).hex()
    # Pointer 13: preempted. The telecommand closed, then level 3 resumed (open) to the end.
    assert second[2:6].hex() == "0000000d"
    assert second[18:30].hex() == "93025443" + "07" + bytes(range(0x3B, 0x42)).hex()
    # Pointer 6: the packet's last six octets, then fill.
    assert third[2:6].hex() == "00000106"
    assert third[18:30].hex() == bytes(range(0x42, 0x48)).hex() + "000000000000"
    # Pointer 14: only idle.
    assert fourth[2:6].hex() == "0000020e"
    assert fourth[18:30] == bytes(12)


def test_downlink_frame():
    sender = LinkSender(DOWNLINK, FLOWS)
    sender.handle_haptic(SAMPLE, 0)
    rtp = bytes.fromhex("80e0 0007 00015f90 deadbeef") + b"payload"
    sender.handle_packet("video", rtp, 0)
    frame = sender.poll_transmit(0)
    assert len(frame) == 500
    # SCID 0x4C; M_PDU header: five spare bits and pointer 0; closed context of flow 0, 19 octets.
    assert frame[:20].hex() == "5301" + "000000" + "20" + SAMPLE.hex() + "0000"
    assert frame[20:42] == bytes.fromhex("a0 0013") + rtp
    assert frame[42:498] == bytes(456)
    assert frame[498:] == struct.pack(">H", crc16_by_division(frame[:498]))
    idle = sender.poll_transmit(0)
    assert idle[:20].hex() == "5301" + "000001" + "00" + "00" * 12 + "07fe"


def test_compressed_headers():
    """Three octets for video, one for voice, after the tag."""
    sender = LinkSender(DOWNLINK, FLOWS)
    video = struct.Struct(">BBHII")
    sender.handle_packet("video", video.pack(0x80, 96, 10, 1000, 1) + b"v", 0)
    sender.handle_packet("voice", video.pack(0x80, 97, 20, 5000, 2) + b"w", 0)
    sender.poll_transmit(0)
    sender.handle_packet("video", video.pack(0x80, 0x80 | 96, 11, 4000, 1) + b"V", 0)
    sender.handle_packet("voice", video.pack(0x80, 97, 21, 5960, 2) + b"W", 0)
    zone = sender.poll_transmit(0)[20:]
    # Voice first: compressed, generation 0, flow 1; two octets; 21.
    assert zone[:5].hex() == "c1" + "0002" + "15" + b"W".hex()
    # Marker 1, sequence 000001011, timestamp 4000 = 00111110100000: 1000 0010 1100 1111 1010 0000.
    assert zone[5:12].hex() == "c0" + "0004" + "82cfa0" + b"V".hex()
    assert zone[12] == 0


def test_what_is_written_is_read():
    for profile in (UPLINK, DOWNLINK):
        sender, receiver = LinkSender(profile, FLOWS), LinkReceiver(profile, FLOWS)
        sender.handle_haptic(SAMPLE, 0)
        sender.handle_packet("tmtc", b"telecommand", 0)
        for slot in range(3):
            receiver.handle_frame(sender.poll_transmit(slot), slot)
        assert receiver.next_event() == HapticReceived(SAMPLE, 0)
        event = receiver.next_event()
        assert isinstance(event, PacketReceived)
        assert (event.flow.name, event.data) == ("tmtc", b"telecommand")
        assert receiver.next_event() is None

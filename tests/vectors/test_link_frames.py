"""Transfer frames of a sender octet by octet, written by hand from docs/wire-formats.md."""

from binascii import crc_hqx

from telepresence.link.flows import Level, packet_flow, video_flow, voice_flow
from telepresence.link.profile import UPLINK
from telepresence.link.receiver import LinkReceiver
from telepresence.link.sender import LinkSender

FLOWS = [
    video_flow("video"),
    voice_flow("voice"),
    packet_flow("maintenance", Level.MAINTENANCE),
    packet_flow("tmtc", Level.TMTC),
]
SAMPLE = bytes.fromhex("0001020304050607 08090a0b")
MESSAGE = b"supervision!"


def fecf(octets):
    """tests/unit/telepresence/link/test_frame.py compares this with the standard's division."""
    return crc_hqx(octets, 0xFFFF).to_bytes(2, "big")


def test_uplink_frame_by_hand():
    sender = LinkSender(UPLINK, FLOWS, first_count=5)
    sender.handle_haptic(SAMPLE, 0)
    sender.handle_packet("tmtc", b"abc", 0)
    frame = sender.poll_transmit(0)
    # '01' version, 0x4B = '01001011' SCID, '000000' VCID, the pointer: 0101 0010 1100 0000.
    header = bytes.fromhex("52c0 000005 40")  # with a sample
    # '1' closed, '0001' raw, '011' flow 3; 3 octets; 7 octets of fill.
    zone = bytes.fromhex("8b 03 616263 00 000000000000")
    body = header + SAMPLE + zone
    assert frame == body + fecf(body)
    assert frame.hex() == "52c000000540000102030405060708090a0b8b0361626300000000000000" + "eea3"


def test_uplink_packet_over_several_frames_with_an_interrupting_telecommand():
    sender = LinkSender(UPLINK, FLOWS, first_count=0xFFFFFF)
    sender.handle_packet("maintenance", bytes(range(0x30, 0x60)), 0)  # 48 octets
    zones = []
    for slot in range(5):
        if slot != 1:
            sender.handle_haptic(SAMPLE, 0)
        if slot == 2:
            sender.handle_packet("tmtc", b"TC", 0)
        frame = sender.poll_transmit(0, MESSAGE if slot == 3 else None)
        zones.append((frame[:6].hex(), frame[6 if slot == 1 else 18 : 30].hex()))
    assert zones == [
        # Open raw tag of flow 2 and the first 11 octets.
        ("52c0ffffff40", "0a" + bytes(range(0x30, 0x3B)).hex()),
        # No sample: pointer 31, no start, and 24 octets that go on.
        ("52df00000000", bytes(range(0x3B, 0x53)).hex()),
        # Pointer 29: preempted. The telecommand closed, then level 3 resumed (open) to the end.
        ("52dd00000140", "8b025443" + "07" + bytes(range(0x53, 0x5A)).hex()),
        # Pointer 28: a supervision message takes the zone.
        ("52dc00000240", MESSAGE.hex()),
        # Pointer 6: the packet's last six octets, then fill.
        ("52c600000340", bytes(range(0x5A, 0x60)).hex() + "000000000000"),
    ]
    # Pointer 30: only idle, with a sample and without.
    sender.handle_haptic(SAMPLE, 0)
    assert sender.poll_transmit(0)[:30] == bytes.fromhex("52de 000004 40") + SAMPLE + bytes(12)
    assert sender.poll_transmit(0)[:30] == bytes.fromhex("52de 000005 00") + bytes(24)
    assert sender.octets() == {
        "header": 7 * 6,
        "fecf": 7 * 2,
        "haptic": 5 * 12,
        "tmtc": 2,
        "voice": 0,
        "video": 0,
        "maintenance": 48,
        "rtcp": 0,
        "packet_headers": 2,
        "framing": 2,
        "supervision": 12,
        "idle": 6 + 12 + 24 + 12 - 12,
    }


def test_a_dropped_packet_is_not_reported_as_ended():
    """Its tag is in the frame before, so the next frame must not say that it ends here."""
    sender, receiver = LinkSender(UPLINK, FLOWS), LinkReceiver(UPLINK, FLOWS)
    sender.handle_packet("maintenance", bytes(100), 0)
    frames = [sender.poll_transmit(0)]
    sender.flush(0)
    frames += [sender.poll_transmit(0, MESSAGE), sender.poll_transmit(0), sender.poll_transmit(0)]
    assert frames[1][1] == 0xDC
    assert frames[2][6:30] == b"\0" + bytes(23)  # fill …
    assert frames[2][1] == 0xDD  # … after the packet was preempted
    assert frames[3][1] == 0xDE
    sender.handle_packet("maintenance", b"next", 0)
    for frame in (*frames, sender.poll_transmit(0)):
        assert receiver.handle_frame(frame, 0)
    assert [event[0] for event in iter(receiver.next_event, None)] == [MESSAGE, FLOWS[2]]
    assert receiver.packets.dropped == {"incomplete": 1}

"""The invariant: no octets from the radio make the receiver raise or grow, and after any garbage a
healthy peer is understood again."""

import os
import struct
from binascii import crc_hqx
from random import Random

import pytest

from telepresence.link.flows import Level, packet_flow, rtcp_flow, video_flow, voice_flow
from telepresence.link.frame import MAX_PACKET_OCTETS
from telepresence.link.profile import DOWNLINK, UPLINK
from telepresence.link.receiver import LinkReceiver, PacketReceived
from telepresence.link.sender import LinkSender

MS = 1_000_000
FRAMES = int(os.environ.get("KONTUR_FUZZ_FRAMES", "40000"))
FLOWS = [
    video_flow("video"),
    voice_flow("voice"),
    rtcp_flow("rtcp"),
    packet_flow("tmtc", Level.TMTC),
    packet_flow("maintenance", Level.MAINTENANCE),
]


def mutated(frame, random):
    """One of the ways in which a frame can be wrong; some keep, or repair, the checksum."""
    octets = bytearray(frame)
    way = random.randrange(6)
    if way == 0:
        return random.randbytes(random.randrange(2 * len(octets)))
    if way == 1:
        return bytes(octets[: random.randrange(len(octets))])
    for _ in range(random.choice((1, 1, 2, 8))):
        octets[random.randrange(len(octets))] ^= 1 << random.randrange(8)
    if way == 2:
        return bytes(octets)
    if way == 3:  # the zone and the pointer, but nothing before
        octets[5] = octets[5] & 0xF0 | random.randrange(16)
        octets[18:] = random.randbytes(len(octets) - 18)
    elif way == 4:  # the count
        octets[2:5] = random.randbytes(3)
    octets[-2:] = struct.pack(">H", crc_hqx(bytes(octets[:-2]), 0xFFFF))
    return bytes(octets)


@pytest.mark.parametrize("profile", [UPLINK, DOWNLINK], ids=lambda profile: profile.name)
def test_mutated_frames(profile):
    random = Random(20_260_101)
    sender, receiver = LinkSender(profile, FLOWS), LinkReceiver(profile, FLOWS)
    handled = mutations = 0
    for slot in range(FRAMES // 2):
        now_ns = slot * MS
        if slot % 3 == 0:
            header = struct.pack(">BBHII", 0x80, 96, slot // 3 & 0xFFFF, slot * 90, 1)
            sender.handle_packet("video", header + random.randbytes(random.randrange(60)), now_ns)
        if slot % 5 == 0:
            sender.handle_packet("tmtc", random.randbytes(random.randrange(30)), now_ns)
        frame = sender.poll_transmit(now_ns)
        if random.random() < 0.3:
            frame = mutated(frame, random)
            mutations += 1
        receiver.handle_frame(frame, now_ns)
        handled += 1
        while receiver.next_event():
            pass
        held = sum(len(partial.body) for partial in receiver._partials if partial)
        assert held <= len(Level) * (MAX_PACKET_OCTETS + 16)
    report = receiver.report()
    assert report["frames"] + sum(report["frames_dropped"].values()) == handled
    assert mutations > FRAMES // 8
    assert report["frames_dropped"]["fecf"] > 0
    assert report["packets_dropped"]["malformed"] > 0

    healthy = LinkSender(profile, FLOWS)
    out = []
    for slot in range(40):
        healthy.handle_packet("tmtc", struct.pack(">I", slot), 0)
        receiver.handle_frame(healthy.poll_transmit(0), (FRAMES + slot) * MS)
        while event := receiver.next_event():
            assert isinstance(event, PacketReceived)
            out.append(event.data)
    # The new life is seen with its first frame, and nothing of it is lost.
    assert out[-39:] == [struct.pack(">I", slot) for slot in range(40)][-len(out) :][-39:]
    assert len(out) >= 39

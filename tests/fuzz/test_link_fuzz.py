"""Invariant: whatever arrives, the receiver counts it and continues.

It never raises. It counts each frame once, as received or as dropped for one reason. It holds no
more than necessary, and after any garbage it understands a healthy peer again.
"""

import struct
from binascii import crc_hqx
from dataclasses import replace
from random import Random

import pytest
from common import first_seed, repeats

from telepresence.link.flows import (
    Level,
    PacketReceived,
    packet_flow,
    rtcp_flow,
    video_flow,
    voice_flow,
)
from telepresence.link.frame import MAX_PACKET_OCTETS
from telepresence.link.profile import DOWNLINK, UPLINK
from telepresence.link.receiver import LinkReceiver
from telepresence.link.sender import LinkSender

MS = 1_000_000
FRAMES = repeats(40_000)
FLOWS = [
    video_flow("video"),
    voice_flow("voice"),
    rtcp_flow("rtcp"),
    packet_flow("tmtc", Level.TMTC),
    packet_flow("maintenance", Level.MAINTENANCE),
]


def mutated(frame, random):
    """Corrupt a frame in one of several ways; some keep, or repair, the checksum."""
    octets = bytearray(frame)
    way = random.randrange(7)
    if way == 0:
        return random.randbytes(random.randrange(2 * len(octets)))
    if way == 1:
        return bytes(octets[: random.randrange(len(octets))])
    if way == 2:
        return bytes(octets) + random.randbytes(random.randrange(1, 9))
    for _ in range(random.choice((1, 1, 2, 8))):
        octets[random.randrange(len(octets))] ^= 1 << random.randrange(8)
    if way == 3:
        return bytes(octets)
    if way == 4:  # the zones and the pointer, but nothing before
        octets[5] = random.choice((0, 0x40))
        if len(octets) < 100:
            octets[1] = 0xC0 | random.randrange(0x20)
        octets[6:] = random.randbytes(len(octets) - 6)
        if len(octets) > 100 and random.random() < 0.8:
            at = 18 if octets[5] & 0x40 else 6
            pointer = random.choice((0, 0, 100, 478, 490, 491, *range(2040, 2048)))
            octets[at : at + 2] = struct.pack(">H", random.choice((0, 0, 0, 0xF800)) | pointer)
    elif way == 5:  # the count
        octets[2:5] = random.randbytes(3)
    octets[-2:] = struct.pack(">H", crc_hqx(bytes(octets[:-2]), 0xFFFF))
    return bytes(octets)


@pytest.mark.rule("7")
@pytest.mark.parametrize("repair", ["off", "auto"])
@pytest.mark.parametrize("profile", [UPLINK, DOWNLINK], ids=lambda profile: profile.name)
def test_mutated_frames(profile, repair):
    random, profile = Random(first_seed(20_260_101)), replace(profile, repair=repair)
    print(f"seed {first_seed(20_260_101)}")
    sender, receiver = LinkSender(profile, FLOWS), LinkReceiver(profile, FLOWS)
    handled = mutations = events = 0
    for slot in range(FRAMES // 2):
        now_ns = slot * MS
        if slot % 3 == 0:
            header = struct.pack(">BBHII", 0x80, 96, slot // 3 & 0xFFFF, slot * 90 & 0xFFFFFFFF, 1)
            sender.handle_packet("video", header + random.randbytes(random.randrange(60)), now_ns)
        if slot % 5 == 0:
            sender.handle_packet("tmtc", random.randbytes(random.randrange(30)), now_ns)
        if slot % 7 == 0:
            sender.handle_packet("maintenance", random.randbytes(random.randrange(900)), now_ns)
        if slot % 2 == 0:
            sender.handle_haptic(random.randbytes(12), now_ns)
        frame = sender.poll_transmit(now_ns, random.randbytes(12) if slot % 50 == 0 else None)
        if random.random() < 0.5:
            frame = mutated(frame, random)
            mutations += 1
        good = receiver.frames_received
        assert receiver.handle_frame(frame, now_ns) == (receiver.frames_received == good + 1)
        handled += 1
        while receiver.next_event():
            events += 1
        held = sum(len(partial.body) for partial in receiver.packets._partials if partial)
        assert held <= len(Level) * (MAX_PACKET_OCTETS + 16)
    report = receiver.report()
    assert report.frames_received + sum(report.frames_dropped.values()) == handled
    samples, told = report.haptic_received, report.supervision_received
    assert events == samples + told + sum(report.packets.values())
    assert mutations > FRAMES // 5
    assert min(report.frames_dropped[why] for why in ("length", "fecf", "late")) > 0
    assert report.packets_dropped["malformed"] > 0
    healthy = LinkSender(profile, FLOWS)
    out = []
    for slot in range(40):
        healthy.handle_packet("tmtc", struct.pack(">I", slot), 0)
        if not receiver.handle_frame(healthy.poll_transmit(0), (FRAMES + slot) * MS):
            receiver.follow_unknown_sender(new_boot_id=True)
        while event := receiver.next_event():
            assert isinstance(event, PacketReceived)
            out.append(event.data)
    # Only the last packet before may be lost with the former life.
    assert out[-40:] == [struct.pack(">I", slot) for slot in range(40)]

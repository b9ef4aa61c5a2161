"""Requirement: a lost frame delays only the packets that it touches, and no packet comes wrong."""

import struct
from collections import Counter
from dataclasses import replace
from random import Random

import pytest
from common import first_seed, repeats

from telepresence.link.flows import Level, PacketReceived, packet_flow, video_flow, voice_flow
from telepresence.link.profile import DOWNLINK, UPLINK
from telepresence.link.reassembly import PacketReassembly
from telepresence.link.receiver import LinkReceiver
from telepresence.link.repair.codes import WINDOW
from telepresence.link.repair.reserve import NOTHING, Kept
from telepresence.link.sender import LinkSender

MS = 1_000_000
FLOWS = [
    video_flow("video"),
    voice_flow("voice"),
    packet_flow("tmtc", Level.TMTC),
    packet_flow("maintenance", Level.MAINTENANCE),
]


class Link:
    """One direction. `run` sends slots and returns what came, by flow, with the slot."""

    def __init__(self, profile, repair="auto"):
        profile = replace(profile, repair=repair)
        self.sender = LinkSender(profile, FLOWS, first_count=256)
        self.receiver = LinkReceiver(profile, FLOWS)
        self.sent, self.came = {flow.name: [] for flow in FLOWS}, {flow.name: [] for flow in FLOWS}
        self.slot = 0
        self._numbers = Counter()

    def send(self, name, octets):
        number = self._numbers[name]
        self._numbers[name] += 1
        data = struct.pack(">BBHII", 0x80, 96, number & 0xFFFF, self.slot * 90, 7)
        data += number.to_bytes(4, "big") + bytes(octets)
        self.sender.handle_packet(name, data, self.slot * MS)
        self.sent[name].append(data)

    def run(self, slots, lost=lambda slot: False, sample=lambda: True):
        for _ in range(slots):
            if sample():
                self.sender.handle_haptic(bytes(12), self.slot * MS)
            frame = self.sender.poll_transmit(self.slot * MS)
            if not lost(self.slot):
                self.receiver.handle_frame(frame, self.slot * MS)
            while event := self.receiver.next_event():
                if isinstance(event, PacketReceived):
                    self.came[event.flow.name].append((self.slot, event.data))
            self.slot += 1


def test_only_what_a_lost_frame_touches_waits():
    link = Link(UPLINK)
    link.run(WINDOW + 10)
    link.send("video", 100)
    # The second slot of the picture is lost; voice and a telecommand come at once.
    link.run(4, lost={WINDOW + 11}.__contains__)
    link.send("voice", 10)
    link.send("tmtc", 1)
    link.run(20)
    begun = WINDOW + 10
    assert [slot - begun for slot, _ in link.came["tmtc"]] == [5]
    assert [slot - begun for slot, _ in link.came["voice"]] == [7]
    ((slot, data),) = link.came["video"]
    assert data == link.sent["video"][0] and slot - begun < 20
    assert link.receiver.report().repaired.zones == 1


@pytest.mark.parametrize("reserve", [NOTHING, Kept(2, 4, 4)])
@pytest.mark.parametrize("profile", [UPLINK, DOWNLINK], ids=lambda profile: profile.name)
def test_no_history_brings_a_wrong_packet(profile, reserve, monkeypatch):
    random = Random(first_seed(11))
    restored, read, most = 0, [0], 0
    read_zone = PacketReassembly.handle_zone

    def count(packets, *zone):
        read[0] += 1
        read_zone(packets, *zone)

    monkeypatch.setattr(PacketReassembly, "handle_zone", count)
    for _ in range(repeats(12)):
        link, lost = Link(profile), set()
        link.sender.reserve = reserve
        loss, burst = random.choice((0.002, 0.01, 0.05, 0.2)), random.choice((1, 3, 10, 30, 90))
        plain = random.choice((0, 0.01, 0.5))
        for slot in range(3000):
            if slot % 33 == 0:
                for _ in range(random.randint(1, 3)):
                    link.send("video", random.randrange(profile.packet_zone_octets * 12))
            if slot % 20 == 3:
                link.send("voice", 20)
            if random.random() < 0.01:
                link.send(random.choice(("tmtc", "maintenance")), random.randrange(300))
            if slot > 100 and random.random() < loss / burst:
                lost.update(range(slot, slot + random.randint(1, 2 * burst)))
            read[0] = 0
            link.run(1, lost.__contains__, lambda share=plain: random.random() >= share)
            most = max(most, read[0])
        for name, sent in link.sent.items():
            places = {data: place for place, data in enumerate(sent)}
            order = [places[data] for _, data in link.came[name]]
            assert len(set(order)) == len(order), name
            assert name == "voice" or order == sorted(order), name
        restored += link.receiver.report().repaired.packets
    # What is read again is spread over slots.
    assert restored > 0 and most <= 33


def test_without_repair_frames_are_as_before():
    plain, repairing = Link(UPLINK, "off"), Link(UPLINK, "idle")
    repairing.sender.set_repair(False)
    for link in (plain, repairing):
        link.frames = []
        for _ in range(300):
            if link.slot % 9 == 0:
                link.send("video", 40)
            link.frames.append(link.sender.poll_transmit(link.slot))
            link.slot += 1
    assert plain.frames == repairing.frames
    assert "repair" not in plain.sender.octets() and plain.receiver.report().repaired is None

"""Half a minute of a full uplink on virtual time: priorities, waits, and the use of octets."""

import struct
from random import Random

import pytest

from telepresence.link.flows import (
    HapticReceived,
    Level,
    SupervisionReceived,
    packet_flow,
    rtcp_flow,
    video_flow,
    voice_flow,
)
from telepresence.link.profile import DOWNLINK, UPLINK
from telepresence.link.queues import DropPolicy, QueueLimits
from telepresence.link.receiver import LinkReceiver
from telepresence.link.sender import LinkSender

MS = 1_000_000
FLOWS = [
    video_flow("video"),
    voice_flow("voice"),
    rtcp_flow("video_rtcp"),
    rtcp_flow("voice_rtcp"),
    packet_flow("tmtc", Level.TMTC),
    packet_flow("maintenance", Level.MAINTENANCE),
]


class Run:
    """Traffic at its caps through one direction, slot by slot; what was put in and came out.

    The peer acknowledges contexts within 20 slots, and each half second has a supervision slot.
    """

    def __init__(self, profile, slots, *, video_bps, voice_octets, packets_a_picture=1, flood=()):
        self.profile, self.slots = profile, slots
        self.sender, self.receiver = LinkSender(profile, FLOWS), LinkReceiver(profile, FLOWS)
        self.sent = {flow.name: [] for flow in FLOWS}
        self.received = {flow.name: [] for flow in FLOWS}
        self.delay_slots = {flow.name: [] for flow in FLOWS}
        self.haptic_slots = []
        random = Random(1)
        self.sender.handle_peer(heard=True)
        for slot in range(slots):
            if slot % 20 == 19:
                self.sender.handle_acknowledgements(self.receiver.context_ids())
            self.sender.handle_haptic(struct.pack(">QI", slot, 0), slot * MS)
            if slot % 100 in (0, 33, 66):
                for _ in range(packets_a_picture):
                    self.put_video(slot, random, video_bps // 8 // 30 // packets_a_picture)
            if slot % 20 == 7:
                number = slot // 20
                header = struct.pack(">BBHII", 0x80, 97, number & 0xFFFF, number * 960, 2)
                self.put("voice", header + random.randbytes(voice_octets), slot)
            if slot % 1000 == 500:
                self.put("tmtc", random.randbytes(20), slot)
            if slot % 5000 == 100:
                self.put("video_rtcp", b"\x80\xc8" + random.randbytes(58), slot)
                self.put("voice_rtcp", b"\x80\xc8" + random.randbytes(58), slot)
            for name, octets in flood:
                self.put(name, random.randbytes(octets), slot)
            self.step(slot)

    def put_video(self, slot, random, octets):
        number = len(self.sent["video"])
        # 30 pictures a second, captured 9 ms ago with a jitter of a millisecond.
        captured = round(slot / 100 * 3) * 3000 - 810 + random.randrange(-45, 46)
        fields = (0x80, 0x80 | 96, number & 0xFFFF, captured & 0xFFFFFFFF, 1)
        self.put("video", struct.pack(">BBHII", *fields) + random.randbytes(octets), slot)

    def put(self, name, data, slot):
        if self.sender.handle_packet(name, data, slot * MS):
            self.sent[name].append((data, slot))

    def step(self, slot):
        frame = self.sender.poll_transmit(slot * MS, b"supervision!" if slot % 500 == 499 else None)
        assert len(frame) == self.profile.frame_octets
        self.receiver.handle_frame(frame, slot * MS)
        while event := self.receiver.next_event():
            if isinstance(event, HapticReceived):
                self.haptic_slots.append(struct.unpack_from(">Q", event.sample)[0])
                continue
            if isinstance(event, SupervisionReceived):
                assert slot % 500 == 499
                continue
            name = event.flow.name
            data, since = self.sent[name][len(self.received[name])]
            assert event.data == data
            self.received[name].append(data)
            self.delay_slots[name].append(slot - since)


@pytest.fixture(scope="module")
def uplink():
    return Run(UPLINK, 30_000, video_bps=85_000, voice_octets=20)


def test_haptics_go_in_every_slot(uplink):
    assert uplink.haptic_slots == list(range(30_000))


def test_everything_fits_at_its_cap(uplink):
    for name, sent in uplink.sent.items():
        assert len(sent) - len(uplink.received[name]) <= 2, name
    queues = uplink.sender.report(30_000 * MS).queue
    assert all(not any(queue.drops.values()) for queue in queues.values())
    # A picture of 354 octets takes 30 slots; the contexts of the first seconds take some more.
    assert max(uplink.delay_slots["video"]) <= 60
    assert max(uplink.delay_slots["video"][90:]) <= 45


def test_voice_and_telecommands_interrupt_video(uplink):
    # 20 octets take two slots; one more may be used by a telecommand or by supervision.
    assert max(uplink.delay_slots["tmtc"]) <= 2
    assert max(uplink.delay_slots["voice"]) <= 3
    assert min(uplink.delay_slots["video"]) >= 28


def test_headers_cost_two_octets_a_packet_on_average(uplink):
    octets = uplink.sender.octets()
    packets = {name: len(received) for name, received in uplink.received.items()}
    others = sum(packets.values()) - packets["video"] - packets["voice"]
    # Tags and RTP headers, including whole ones and contexts; other packets have a tag each.
    assert octets["packet_headers"] - others <= 2.05 * (packets["video"] + packets["voice"])
    # With the lengths of pieces and the resume tags.
    assert octets["packet_headers"] + octets["framing"] <= 3 * sum(packets.values())


def test_octet_counts_are_exact(uplink):
    octets = uplink.sender.octets()
    assert sum(octets.values()) == 30_000 * 32
    assert octets["haptic"] == 30_000 * 12
    assert octets["header"] == 30_000 * 6
    assert octets["fecf"] == 30_000 * 2
    assert octets["supervision"] == 60 * 12
    assert octets["tmtc"] == 30 * 20
    assert octets["voice"] == 1500 * 20


def test_a_telecommand_takes_the_next_slot_and_video_continues():
    sender, receiver = LinkSender(UPLINK, FLOWS), LinkReceiver(UPLINK, FLOWS)
    video = struct.pack(">BBHII", 0x80, 96, 1, 2, 3) + bytes(range(100))
    sender.handle_packet("video", video, 0)
    arrived = {}
    for slot in range(20):
        sender.handle_haptic(bytes(12), slot)
        if slot == 4:
            sender.handle_packet("tmtc", b"now", slot)
        receiver.handle_frame(sender.poll_transmit(slot), slot)
        while event := receiver.next_event():
            if not isinstance(event, HapticReceived):
                arrived[event.flow.name] = (slot, event.data)
    assert arrived["tmtc"] == (4, b"now")
    # 113 octets alone take ten slots; the telecommand costs five and the resume tag one.
    assert arrived["video"] == (9, video)


def test_levels_below_a_flooded_one_wait_and_voice_still_flows():
    run = Run(UPLINK, 5_000, video_bps=85_000, voice_octets=20, flood=[("maintenance", 40)])
    assert max(run.delay_slots["voice"]) <= 3
    assert max(run.delay_slots["video"]) <= 60
    assert len(run.received["maintenance"]) > 0
    assert sum(run.sender.octets().values()) == 5_000 * 32


def test_a_flood_of_telecommands_is_limited_and_counted():
    run = Run(UPLINK, 10_000, video_bps=75_000, voice_octets=20, flood=[("tmtc", 20)])
    queues = run.sender.report(10_000 * MS).queue
    assert len(run.sent["voice"]) - len(run.received["voice"]) <= 2
    assert len(run.sent["video"]) - len(run.received["video"]) <= 8
    assert not any(queues["voice"].drops.values())
    assert not any(queues["video"].drops.values())
    # A burst of 512 octets, and 8 kbit/s after it; what is left unused carries some more.
    assert 10_000 + 512 <= run.sender.octets()["tmtc"] < 14_000
    assert queues["tmtc"].drops["full"] > 8_500
    assert queues["tmtc"].delayed > 400
    assert queues["tmtc"].max_octets <= 8192
    assert run.haptic_slots == list(range(10_000))


def test_downlink_at_its_caps_has_no_waiting():
    run = Run(DOWNLINK, 10_000, video_bps=512_000, voice_octets=160, packets_a_picture=2)
    assert max(max(delays, default=0) for delays in run.delay_slots.values()) <= 5
    assert len(run.received["video"]) >= 10 * 60 - 2
    assert sum(run.sender.octets().values()) == 10_000 * 500
    assert run.sender.octets()["voice"] == 500 * 160


def test_the_newest_sample_wins():
    sender, receiver = LinkSender(UPLINK, FLOWS), LinkReceiver(UPLINK, FLOWS)
    for octet in range(3):
        sender.handle_haptic(bytes([octet]) * 12, 0)
    receiver.handle_frame(sender.poll_transmit(0), 0)
    receiver.handle_frame(sender.poll_transmit(MS), MS)
    assert receiver.next_event() == HapticReceived(bytes([2]) * 12, 0)
    assert receiver.next_event() is None
    assert (sender.haptic_sent, sender.haptic_superseded) == (1, 2)
    assert sender.octets()["haptic"] == 12
    assert sender.octets()["idle"] == 12 + 24


LEVELS = [packet_flow(level.name.lower(), level) for level in Level]


@pytest.mark.parametrize("octets", [20, 50, 100, 350, 1000, 2000])
@pytest.mark.parametrize("sampled", [True, False], ids=["samples", "no samples"])
@pytest.mark.parametrize("profile", [UPLINK, DOWNLINK], ids=lambda profile: profile.name)
@pytest.mark.parametrize("level", Level, ids=lambda level: level.name)
def test_a_saturated_level_uses_all_remaining_capacity(profile, level, sampled, octets):
    """Higher levels send something now and then; this level gets all of the rest."""
    slots = 400 if profile is DOWNLINK else 4_000
    limits = QueueLimits(
        depth_octets=10_000, max_age_ns=60_000 * MS, policy=DropPolicy.REJECT_NEWEST
    )
    sender = LinkSender(profile, LEVELS, limits=dict.fromkeys(Level, limits))
    random = Random(level * 10_000 + octets)
    name = level.name.lower()
    for slot in range(slots):
        if sampled:
            sender.handle_haptic(bytes(12), slot * MS)
        for higher in range(level):
            if random.random() < 0.02:
                sender.handle_packet(LEVELS[higher].name, bytes(random.randrange(60)), slot * MS)
        while sender.waiting_octets(level) < 1500:
            sender.handle_packet(name, bytes(octets), slot * MS)
        sender.poll_transmit(slot * MS)
    books = sender.octets()
    zones = profile.packet_zone_octets if sampled else profile.largest_zone_octets
    higher = [LEVELS[above].name for above in range(level)]
    # Their tags, lengths and resume tags are at most 4 octets each.
    others = sum(books[above] for above in higher)
    packets = sum(sender.report(0).queue[above].accepted for above in higher)
    left = zones * slots - others - 4 * packets
    overhead = books["packet_headers"] + books["framing"] - profile.mpdu_octets * slots
    assert books["idle"] == 0
    assert books[name] + overhead >= 0.99 * left
    if octets >= 350:
        assert books[name] >= 0.99 * left
    else:
        # A tag, and at most two octets of length if a packet ends in the zone where it begins.
        assert books[name] >= 0.995 * octets / (octets + 2) * left


@pytest.mark.parametrize("profile", [UPLINK, DOWNLINK], ids=lambda profile: profile.name)
def test_missing_samples_leave_octets_to_lower_levels(profile):
    """A deadband leaves out three samples of four: their octets carry maintenance."""
    sender, slots = LinkSender(profile, LEVELS), 2_000
    for slot in range(slots):
        if slot % 4 == 0:
            sender.handle_haptic(bytes(12), slot * MS)
        while sender.waiting_octets(Level.MAINTENANCE) < 2000:
            sender.handle_packet("maintenance", bytes(1000), slot * MS)
        sender.poll_transmit(slot * MS)
    books = sender.octets()
    assert books["idle"] == 0
    assert books["maintenance"] >= 0.99 * (profile.packet_zone_octets + 9) * slots

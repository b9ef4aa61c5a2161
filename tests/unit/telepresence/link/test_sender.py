"""Which packet a sender sends next, when it drops one, and what becomes of each octet."""

import struct
from collections import deque
from random import Random

import pytest

from telepresence.haptics.mediated.wall import WallMessage, pack_wall
from telepresence.link.flows import (
    HapticReceived,
    Level,
    PacketReceived,
    packet_flow,
    rtcp_flow,
    tmtc_flow,
    video_flow,
    voice_flow,
)
from telepresence.link.profile import DOWNLINK, UPLINK
from telepresence.link.queues import MOST_EXPIRED, DropPolicy, QueueLimits
from telepresence.link.receiver import LinkReceiver
from telepresence.link.sender import MOST_PIECES, LinkSender
from telepresence.tmtc.pus.packets import Telecommand, pack_packet

MS = 1_000_000
FLOWS = [
    video_flow("video"),
    voice_flow("voice"),
    rtcp_flow("video_rtcp"),
    rtcp_flow("voice_rtcp"),
    packet_flow("tmtc", Level.TMTC),
    packet_flow("maintenance", Level.MAINTENANCE),
]
#: A raw flow for each level, and RTCP at the level of video.
RAW = [*(packet_flow(level.name.lower(), level) for level in Level), rtcp_flow("rtcp")]
TELECOMMAND = pack_packet(Telecommand(apid=0x133, count=7, service=8, subtype=1, data=b"s"))
PROFILES = pytest.mark.parametrize("profile", [UPLINK, DOWNLINK], ids=lambda profile: profile.name)


class Line:
    """A sender and its receiver, slot by slot.

    taken: by flow, how many packets were queued. ages: by flow, how many slots each packet that
    came out was under way. What comes out must have been put in, in its order.
    """

    def __init__(self, profile=UPLINK, flows=RAW, *, limits=None, timeout_ns=None):
        self.sender = LinkSender(profile, flows, limits=limits)
        self.receiver = LinkReceiver(profile, flows)
        self.sender.set_timeout(timeout_ns)
        self.profile, self.slot, self.number = profile, 0, 0
        self.taken = {flow.name: 0 for flow in flows}
        self.ages = {flow.name: [] for flow in flows}
        self.waiting = {flow.name: deque() for flow in flows}
        self.haptic_slots = []

    def put(self, name, what):
        """what: a packet, or the octets of one (8 at least) that is unlike all others."""
        if isinstance(what, int):
            self.number += 1
            # Also an RTCP header, of which only the first octets are checked.
            what = struct.pack(">BBHI", 0x80, 200, 0, self.number) + bytes(what - 8)
        if self.sender.handle_packet(name, what, self.slot * MS):
            self.taken[name] += 1
            self.waiting[name].append((what, self.slot))

    def step(self, message=None):
        now_ns = self.slot * MS
        self.sender.handle_haptic(struct.pack(">QI", self.slot, 0), now_ns)
        frame = self.sender.poll_transmit(now_ns, message)
        assert len(frame) == self.profile.frame_octets
        assert self.receiver.handle_frame(frame, now_ns)
        for event in iter(self.receiver.next_event, None):
            if isinstance(event, HapticReceived):
                self.haptic_slots.append(struct.unpack_from(">Q", event.sample)[0])
            elif isinstance(event, PacketReceived):
                queued = self.waiting[event.flow.name]
                while (one := queued.popleft())[0] != event.data:
                    pass
                self.ages[event.flow.name].append(self.slot - one[1])
            else:
                assert event.message == message
        self.slot += 1

    def run(self, slots, packets=lambda slot: ()):
        """packets(slot): what is put in before each slot, as pairs for `put`."""
        for slot in range(slots):
            for name, what in packets(slot):
                self.put(name, what)
            self.step()
        return self

    @property
    def queues(self):
        return self.sender.report(self.slot * MS).queue

    def missing(self, name):
        return self.taken[name] - len(self.ages[name])


def rtp(second, number, timestamp, ssrc):
    return struct.pack(">BBHII", 0x80, second, number & 0xFFFF, timestamp & 0xFFFFFFFF, ssrc)


def loaded(profile, slots, *, video_bps, voice_octets, packets_a_picture=1, flood=()):
    """Traffic at its caps; each half second has a message."""
    line, random = Line(profile, FLOWS), Random(1)
    for slot in range(slots):
        for _ in range(packets_a_picture if slot % 100 in (0, 33, 66) else 0):
            # 30 pictures a second, captured 9 ms ago with a jitter of a millisecond.
            captured = round(slot / 100 * 3) * 3000 - 810 + random.randrange(-45, 46)
            header = rtp(0xE0, line.taken["video"], captured, 1)
            line.put("video", header + random.randbytes(video_bps // 240 // packets_a_picture))
        if slot % 20 == 7:
            header = rtp(97, slot // 20, slot // 20 * 960, 2)
            line.put("voice", header + random.randbytes(voice_octets))
        if slot % 1000 == 500:
            line.put("tmtc", random.randbytes(20))
        if slot % 5000 == 100:
            for name in ("video_rtcp", "voice_rtcp"):
                line.put(name, b"\x80\xc8" + random.randbytes(58))
        for name, octets in flood:
            line.put(name, random.randbytes(octets))
        line.step(b"supervision!" if slot % 500 == 499 else None)
    assert line.haptic_slots == list(range(slots))
    assert sum(line.sender.octets().values()) == slots * profile.frame_octets
    return line


def test_an_uplink_at_its_caps_loses_nothing_and_video_alone_waits():
    line = loaded(UPLINK, 20_000, video_bps=85_000, voice_octets=20)
    assert all(line.missing(name) <= 2 for name in line.taken)
    assert all(not any(queue.drops.values()) for queue in line.queues.values())
    # 20 octets take two slots; one more may be used by a telecommand or by supervision.
    assert max(line.ages["tmtc"]) <= 2
    assert max(line.ages["voice"]) <= 3
    # A picture of 354 octets takes 30 slots; the whole headers take some more.
    assert 28 <= min(line.ages["video"]) <= max(line.ages["video"]) <= 60
    assert max(line.ages["video"][90:]) <= 45
    octets = line.sender.octets()
    exact = {"haptic": 12, "header": 6, "fecf": 2}
    assert {kind: octets[kind] for kind in exact} == {k: 20_000 * n for k, n in exact.items()}
    assert (octets["supervision"], octets["tmtc"], octets["voice"]) == (480, 400, 20_000)
    # Tags and RTP headers, including whole ones; other packets have a tag each.
    media = len(line.ages["video"]) + len(line.ages["voice"])
    others = sum(map(len, line.ages.values())) - media
    assert octets["packet_headers"] - others <= 2.45 * media
    # With the lengths of pieces and the resume tags.
    assert octets["packet_headers"] + octets["framing"] <= 3.4 * (media + others)


def test_a_flood_of_telecommands_is_limited_and_counted():
    line = loaded(UPLINK, 10_000, video_bps=75_000, voice_octets=20, flood=[("tmtc", 20)])
    queues = line.queues
    assert line.missing("voice") <= 2 and line.missing("video") <= 8
    assert not any([*queues["voice"].drops.values(), *queues["video"].drops.values()])
    # A burst of 512 octets, and 8 kbit/s after it; what is left unused carries some more.
    assert 10_000 + 512 <= line.sender.octets()["tmtc"] < 14_000
    assert queues["tmtc"].drops["full"] > 8_500
    assert queues["tmtc"].delayed > 400
    assert queues["tmtc"].max_octets <= 8192


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


@pytest.mark.parametrize("octets", [20, 100, 1000])
@pytest.mark.parametrize("sampled", [True, False], ids=["samples", "no samples"])
@PROFILES
@pytest.mark.parametrize("level", Level, ids=lambda level: level.name)
def test_a_saturated_level_uses_all_remaining_capacity(profile, level, sampled, octets):
    """Higher levels send something now and then; this level gets all of the rest."""
    slots = 400 if profile is DOWNLINK else 4_000
    limits = QueueLimits(
        depth_octets=10_000, max_age_ns=60_000 * MS, policy=DropPolicy.REJECT_NEWEST
    )
    sender = LinkSender(profile, RAW, limits=dict.fromkeys(Level, limits))
    random = Random(level * 10_000 + octets)
    name = level.name.lower()
    for slot in range(slots):
        if sampled:
            sender.handle_haptic(bytes(12), slot * MS)
        for higher in range(level):
            if random.random() < 0.02:
                sender.handle_packet(RAW[higher].name, bytes(random.randrange(60)), slot * MS)
        while sender.waiting_octets(level) < 1500:
            sender.handle_packet(name, bytes(octets), slot * MS)
        sender.poll_transmit(slot * MS)
    books = sender.octets()
    zones = profile.packet_zone_octets if sampled else profile.largest_zone_octets
    higher = [RAW[above].name for above in range(level)]
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


@pytest.mark.rule("4")
@pytest.mark.parametrize(
    ("flow", "octets", "most_ms", "beside", "patience_ms"),
    [
        ("video", 1212, 500, 11, None),
        ("voice", 160, 100, 11, None),
        ("video", 1212, 80, 10, 80),
        ("rtcp", 1212, 50, 10, 50),
    ],
)
def test_no_packet_is_sent_beyond_its_age(flow, octets, most_ms, beside, patience_ms):
    """Telemetry of 18 octets interrupts it again and again; alone it would be sent in time."""

    def packets(slot):
        telemetry = [("tmtc", 18)] * beside if slot % 20 == 0 else []
        return [*telemetry, (flow, octets)] if slot % 1000 == 0 else telemetry

    endless = QueueLimits(
        depth_octets=8_192, max_age_ns=10_000 * MS, policy=DropPolicy.REJECT_NEWEST
    )
    timeout_ns = None if patience_ms is None else patience_ms * MS
    line = Line(limits={Level.TMTC: endless}, timeout_ns=timeout_ns).run(2_900, packets)
    assert max(line.ages[flow], default=0) <= most_ms
    queue = line.queues["voice" if flow == "voice" else "video"]
    reason = "expired" if patience_ms is None else "signal_lost"
    assert len(line.ages[flow]) + queue.drops[reason] == line.taken[flow] == 3
    assert queue.max_age_ns == most_ms * MS


def each(interval, name, octets, phase=0):
    return lambda slot: [(name, octets)] if slot % interval == phase else []


def beside(*sources):
    return lambda slot: [packet for source in sources for packet in source(slot)]


def test_all_rtcp_gets_through_an_overload_and_a_flood_of_it_leaves_half_to_media():
    line = Line().run(20_500, beside(each(1000, "rtcp", 60, 500), each(30, "video", 460)))
    assert len(line.ages["rtcp"]) == line.taken["rtcp"] == 20
    # At most a packet of video goes first.
    assert max(line.ages["rtcp"]) <= 45
    assert len(line.ages["video"]) > 0.7 * line.taken["video"]
    line = Line().run(10_000, beside(each(1, "rtcp", 400), each(40, "video", 400)))
    assert len(line.ages["video"]) > 0.45 * 10_000 * 12 / 401
    assert 0.9 < len(line.ages["rtcp"]) / len(line.ages["video"]) < 1.2


@PROFILES
@pytest.mark.parametrize("octets", [0, 1])
def test_a_slot_touches_a_limited_number_of_packets(profile, octets):
    """40,000 packets of maintenance: many wait, most are refused, those too old go in portions."""
    limits = QueueLimits(
        depth_octets=1 << 20,
        depth_packets=32_768,
        max_age_ns=20 * MS,
        policy=DropPolicy.REJECT_NEWEST,
    )
    for chosen in ({}, {Level.MAINTENANCE: limits}):
        sender = LinkSender(profile, RAW, limits=chosen)
        for _ in range(40_000):
            sender.handle_packet("maintenance", bytes(octets), 0)
        queue = sender.queue(Level.MAINTENANCE)
        assert len(queue) <= (32_768 if chosen else 1024)
        most, slot = 0, 0
        while len(queue):
            before = len(queue)
            sender.poll_transmit(slot * MS)
            most = max(most, before - len(queue))
            slot += 1
        assert most <= MOST_EXPIRED + MOST_PIECES
        if chosen:
            assert sender.report(slot * MS).queue["maintenance"].drops["expired"] > 30_000
        sender.handle_packet("maintenance", b"after", slot * MS)
        assert b"after" in b"".join(sender.poll_transmit(slot * MS) for _ in range(2))


def test_flushed_packets_are_never_sent_and_counted_by_level():
    sender, receiver = LinkSender(UPLINK, RAW), LinkReceiver(UPLINK, RAW)
    for name, data in (("rtcp", b"\x80\xc8" + bytes(60)), ("tmtc", b"t" * 60), ("tmtc", b"u" * 9)):
        sender.handle_packet(name, data, 0)
        receiver.handle_frame(sender.poll_transmit(0), 0)
    sender.flush(0)
    sender.handle_packet("tmtc", b"after", 0)
    for _ in range(9):
        receiver.handle_frame(sender.poll_transmit(0), 0)
    assert [event.data for event in iter(receiver.next_event, None)] == [b"after"]
    queues = sender.report(0).queue
    assert queues["tmtc"].drops["signal_lost"] == 2
    assert queues["video"].drops["signal_lost"] == 1


@PROFILES
def test_every_length_from_every_position(profile):
    """A packet of each length, begun at each position in the zone, arrives unchanged."""
    zone = profile.largest_zone_octets
    positions = range(zone) if zone < 25 else (0, 1, zone - 5, zone - 4, zone - 3, zone - 2)
    lengths = [*range(40), *range(zone - 12, zone + 4), 127, 128, 2 * zone]
    for before in positions:
        for length in lengths:
            sender, receiver = LinkSender(profile, FLOWS), LinkReceiver(profile, FLOWS)
            packets = [bytes([7]) * before, bytes(range(256)) * 8, b"last"]
            packets[1] = packets[1][:length]
            for packet in packets:
                assert sender.handle_packet("tmtc", packet, 0)
            for slot in range(6 + (before + length) // (zone - 2)):
                receiver.handle_frame(sender.poll_transmit(slot), slot)
            out = [event.data for event in iter(receiver.next_event, None)]
            assert out == packets, (before, length)
            assert sum(sender.octets().values()) == sender.frames_sent * profile.frame_octets


@pytest.mark.rule("7")
@pytest.mark.parametrize(
    ("flow", "data", "plausible"),
    [
        (video_flow("f"), b"\x80" + bytes(11), True),
        (video_flow("f"), b"\x80" + bytes(10), False),
        (video_flow("f"), b"\x40" + bytes(11), False),
        (video_flow("f"), b"\xc0" + bytes(11), False),
        (rtcp_flow("f"), b"\x80\xc0" + bytes(6), True),
        (rtcp_flow("f"), b"\x80\xdf" + bytes(6), True),
        (rtcp_flow("f"), b"\x80\xbf" + bytes(6), False),
        (rtcp_flow("f"), b"\x80\xe0" + bytes(6), False),
        (rtcp_flow("f"), b"\x80\xc8" + bytes(5), False),
        (rtcp_flow("f"), b"\x40\xc8" + bytes(6), False),
        (tmtc_flow("f"), bytes(12), False),
        (tmtc_flow("f"), pack_wall(WallMessage(1, None), 16_383), True),
        (tmtc_flow("f"), TELECOMMAND, True),
        (tmtc_flow("f"), TELECOMMAND[:-1], False),
        (packet_flow("f", Level.VIDEO), b"", True),
        (packet_flow("f", Level.VIDEO), bytes(2048), True),
    ],
)
def test_garbage_takes_no_capacity(flow, data, plausible):
    sender = LinkSender(DOWNLINK, [flow])
    assert sender.handle_packet("f", data, 0) is plausible
    assert sender.refused["garbage"] == (not plausible)
    assert not sender.handle_packet("f", bytes(2049), 0) and sender.refused["oversize"] == 1
    assert not sender.handle_haptic(bytes(11), 0) and sender.refused["haptic_length"] == 1

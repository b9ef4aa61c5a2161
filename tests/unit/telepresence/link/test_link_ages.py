"""What overload does on the link, on virtual time: ages, RTCP, and the work of a slot."""

import struct

import pytest

from telepresence.link.flows import Level, PacketReceived, packet_flow, rtcp_flow
from telepresence.link.profile import DOWNLINK, UPLINK
from telepresence.link.queues import MOST_EXPIRED, DropPolicy, QueueLimits
from telepresence.link.receiver import LinkReceiver
from telepresence.link.sender import MOST_PIECES, LinkSender

MS = 1_000_000
FLOWS = [
    packet_flow("tmtc", Level.TMTC),
    packet_flow("voice", Level.VOICE),
    packet_flow("video", Level.VIDEO),
    rtcp_flow("rtcp"),
    packet_flow("maintenance", Level.MAINTENANCE),
]
#: TM/TC that may interrupt everything else for as long as it likes.
ENDLESS = {
    Level.TMTC: QueueLimits(
        depth_octets=8_192, max_age_ns=10_000 * MS, policy=DropPolicy.REJECT_NEWEST
    )
}


class Run:
    """`put(slot)` says what is queued before each slot: flow and octets, at least 8."""

    def __init__(self, slots, put, *, limits=None, patience_ns=None):
        self.sender = LinkSender(UPLINK, FLOWS, limits=limits)
        self.receiver = LinkReceiver(UPLINK, FLOWS)
        self.sender.set_patience(patience_ns)
        self.offered = {flow.name: 0 for flow in FLOWS}
        #: By flow, the age of each packet in the slot of its last octet, in milliseconds.
        self.ages = {flow.name: [] for flow in FLOWS}
        queued = {}
        for slot in range(slots):
            self.sender.handle_haptic(bytes(12), slot * MS)
            for name, octets in put(slot):
                number = len(queued)
                # Also an RTCP header, of which only the first octets are checked.
                data = struct.pack(">BBHI", 0x80, 200, 0, number) + bytes(octets - 8)
                self.offered[name] += 1
                queued[number] = slot
                self.sender.handle_packet(name, data, slot * MS)
            self.receiver.handle_frame(self.sender.poll_transmit(slot * MS), slot * MS)
            while event := self.receiver.next_event():
                if isinstance(event, PacketReceived):
                    number = struct.unpack_from(">I", event.data, 4)[0]
                    self.ages[event.flow.name].append(slot - queued[number])
        self.queue = self.sender.report(slots * MS).queue


@pytest.mark.parametrize(
    ("flow", "octets", "most_ms", "beside", "patience_ms"),
    [
        ("video", 1212, 500, 11, None),
        ("voice", 160, 100, 11, None),
        ("video", 1212, 80, 10, 80),
    ],
    ids=["video", "voice", "patience"],
)
def test_no_packet_is_sent_beyond_its_age(flow, octets, most_ms, beside, patience_ms):
    """Telemetry of 18 octets interrupts it again and again; alone it would be sent in time."""

    def put(slot):
        packets = [("tmtc", 18)] * beside if slot % 20 == 0 else []
        return [*packets, (flow, octets)] if slot % 1000 == 0 else packets

    patience_ns = None if patience_ms is None else patience_ms * MS
    run = Run(2_900, put, limits=ENDLESS, patience_ns=patience_ns)
    assert max(run.ages[flow], default=0) <= most_ms
    assert run.offered[flow] == 3
    queue = run.queue[flow]
    reason = "expired" if patience_ms is None else "signal_lost"
    assert len(run.ages[flow]) + queue.drops[reason] == 3
    assert queue.max_age_ns == most_ms * MS


def test_the_report_shows_the_age_of_the_last_octet():
    run = Run(1_000, lambda slot: [("video", 600)] if slot % 100 == 0 else [])
    # With its tag it takes 51 slots, the last of them 50 ms after its arrival.
    assert set(run.ages["video"]) == {50}
    assert run.queue["video"].max_age_ns == 50 * MS


def test_overload_wastes_little_on_packets_that_come_too_late():
    """Twice the capacity in large packets beside voice: what is begun mostly ends in time."""

    def put(slot):
        packets = [("voice", 33)] if slot % 20 == 7 else []
        return [*packets, ("video", 720)] if slot % 33 == 0 else packets

    run = Run(20_000, put)
    sent = run.sender.octets()["video"]
    assert sent > 0.99 * (20_000 * 12 - 1000 * 36)
    assert 720 * len(run.ages["video"]) >= 0.97 * sent
    assert len(run.ages["voice"]) == run.offered["voice"]


def test_all_rtcp_gets_through_an_overload_of_its_level():
    def put(slot):
        packets = [("rtcp", 60)] if slot % 1000 == 500 else []
        return [*packets, ("video", 460)] if slot % 30 == 0 else packets

    run = Run(20_500, put)
    assert len(run.ages["rtcp"]) == run.offered["rtcp"] == 20
    # At most a packet of video goes first.
    assert max(run.ages["rtcp"]) <= 45
    assert len(run.ages["video"]) > 0.7 * run.offered["video"]


def test_a_flood_of_rtcp_leaves_half_to_media():
    run = Run(10_000, lambda slot: [("rtcp", 400), *([("video", 400)] if slot % 40 == 0 else [])])
    assert len(run.ages["video"]) > 0.45 * 10_000 * 12 / 401
    assert 0.9 < len(run.ages["rtcp"]) / len(run.ages["video"]) < 1.2


@pytest.mark.parametrize("profile", [UPLINK, DOWNLINK], ids=lambda profile: profile.name)
@pytest.mark.parametrize("octets", [0, 1])
def test_a_slot_touches_a_limited_number_of_packets(profile, octets):
    """300,000 packets of maintenance: many wait, most are refused, those too old go in portions."""
    limits = QueueLimits(
        depth_octets=1 << 20,
        depth_packets=65_536,
        max_age_ns=20 * MS,
        policy=DropPolicy.REJECT_NEWEST,
    )
    for chosen in ({}, {Level.MAINTENANCE: limits}):
        sender = LinkSender(profile, FLOWS, limits=chosen)
        for _ in range(300_000):
            sender.handle_packet("maintenance", bytes(octets), 0)
        queue = sender.queue(Level.MAINTENANCE)
        assert len(queue) <= (65_536 if chosen else 1024)
        most, slot = 0, 0
        while len(queue):
            before = len(queue)
            sender.poll_transmit(slot * MS)
            most = max(most, before - len(queue))
            slot += 1
        assert most <= MOST_EXPIRED + MOST_PIECES
        if chosen:
            assert sender.report(slot * MS).queue["maintenance"].drops["expired"] > 60_000
        sender.handle_packet("maintenance", b"after", slot * MS)
        assert b"after" in b"".join(sender.poll_transmit(slot * MS) for _ in range(2))
